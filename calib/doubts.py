"""What makes an answer doubtful, said in words, with what to do about it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.camera import View
from calib.fit import FittedTdoas, robust_sigma
from calib.joint.uncertainty import microphone_covariances
from calib.sound import SoundArrivals
from rigs.description import Medium, RigDescription
from rigs.session.reader import Session

FloatArray = NDArray[np.float64]

GOOD_RMS_PX = 0.5
LARGE_STD_M = 0.005
DOUBTFUL_SPEED_SIGMAS = 3.0
USUAL_SIGMA_S = 0.5e-6  # of TDOAs measured in a room's sound
LARGE_SIGMA_FACTOR = 3.0
LARGE_REJECTED_SHARE = 0.05
CULPRIT_SHARE = 0.5
FEW_PAIRS = 3
SELDOM_SHARE = 0.8  # a buzzer that is heard less often is named
NOISY_FACTOR = 3.0  # of a channel's uncertainty over the others'


def session_doubts(session: Session) -> list[str]:
    """Say what is wrong with the file: cut off, or not as it was written."""
    doubts = list(session.verify())
    if not session.complete:
        doubts.insert(0, "the session was cut off, or is still being captured: only what was in the file then is used")
    return doubts


def buzzer_doubts(session: Session, sound: SoundArrivals | None) -> list[str]:
    """Name buzzers that were seldom or never heard, of the poses that count."""
    poses = session.poses["pose"][session.poses["accepted"] == 1]
    emissions = session.emissions
    good = (emissions["accepted"] == 1) & np.isin(emissions["pose"], poses)
    if sound is not None:
        good[sound.rows] &= np.isfinite(sound.arrival_s).sum(axis=1) >= 2
    n_wanted, doubts = len(poses) * session.description.signal.repeats, []
    for buzzer in session.description.board.buzzers:
        n_heard = int(np.count_nonzero(good & (emissions["buzzer"] == buzzer.id)))
        if n_heard < SELDOM_SHARE * n_wanted:
            seldom = f"only {n_heard} of its {n_wanted} times" if n_heard else f"in none of {len(poses)} poses"
            doubts.append(
                f"buzzer {buzzer.id} was heard {seldom}: check its wires, its pin on the board and its loudness; the "
                "answer rests on the other buzzers"
            )
    return doubts


def noise_doubts(sound: SoundArrivals) -> list[str]:
    """Name channels whose arrivals are much less certain than those of the others."""
    stds_s = {
        channel: float(np.median(std_s[heard]))
        for channel, std_s, heard in zip(sound.channels, sound.std_s.T, np.isfinite(sound.arrival_s).T, strict=True)
        if heard.any()
    }
    usual_s = float(np.median(list(stds_s.values())))
    return [
        f"channel {channel} is noisy: its arrivals are uncertain by {1e6 * std_s:.2g} us, usual here is "
        f"{1e6 * usual_s:.2g} us: check its cable, gain and ground"
        for channel, std_s in stds_s.items()
        if std_s > NOISY_FACTOR * usual_s
    ]


def view_doubts(view: View) -> list[str]:
    """Say when corners do not fit the camera."""
    if view.rms_px <= GOOD_RMS_PX:
        return []
    doubt = (
        f"corners fit the camera to {view.rms_px:.2f} px only (good: under {GOOD_RMS_PX}): check focus, that the board "
        "is flat, and camera.intrinsics"
    )
    return [doubt]


def speed_doubts(speed_m_s: float, medium: Medium) -> list[str]:
    """Say when sound and pictures do not agree on the scale of the world."""
    deviation = (speed_m_s - medium.speed_m_s()) / medium.speed_std_m_s()
    if abs(deviation) < DOUBTFUL_SPEED_SIGMAS:
        return []
    doubt = (
        f"the speed of sound came out at {speed_m_s:.1f} m/s, {abs(deviation):.1f} standard deviations from the rig's "
        f"{medium.speed_m_s():.1f} m/s: check medium in the rig description, and that the board was printed to scale"
    )
    return [doubt]


def fit_doubts(description: RigDescription, fitted: FittedTdoas) -> list[str]:
    """Say when TDOAs do not fit: too many rejected, with the likely culprit, or too large a scatter."""
    doubts = []
    rejected = fitted.present & ~fitted.used
    share = rejected.sum() / fitted.present.sum()
    if share > LARGE_REJECTED_SHARE:
        doubts.append(f"{share:.0%} of the TDOAs do not fit and were rejected{_culprit(fitted, rejected)}")
    expected_s = float(np.hypot(USUAL_SIGMA_S, description.board.buzzer_std_m / fitted.speed_m_s))
    sigma_s = robust_sigma(fitted.residuals_s)
    if sigma_s > LARGE_SIGMA_FACTOR * expected_s:
        doubts.append(
            f"TDOAs scatter by {1e6 * sigma_s:.1f} us, usual is {1e6 * expected_s:.1f} us: noise or "
            "echo, or buzzers that are not where board.buzzers says"
        )
    return doubts


def spread_doubts(covariance_m2: FloatArray, channels: tuple[int, ...]) -> list[str]:
    """Say which microphone is too uncertain, from the covariance (3 n_mics, 3 n_mics) of all."""
    std_m = np.sqrt(np.linalg.eigvalsh(microphone_covariances(covariance_m2, len(channels)))[:, -1])
    worst = int(np.argmax(std_m))
    if std_m[worst] <= LARGE_STD_M:
        return []
    doubt = (
        f"channel {channels[worst]} is uncertain by {1e3 * std_m[worst]:.1f} mm in its weakest direction: capture a "
        "session with more poses, tilted both ways and at several distances"
    )
    return [doubt]


def _culprit(fitted: FittedTdoas, rejected: NDArray[np.bool_]) -> str:
    """Name the buzzers or poses most of whose TDOAs were rejected, empty where none stands out."""
    kinds = {
        "buzzer": (fitted.buzzer, rejected.sum(axis=1), fitted.present.sum(axis=1)),
        "pose": (fitted.pose, rejected.sum(axis=1), fitted.present.sum(axis=1)),
    }
    for kind, (labels, n_rejected, n_present) in kinds.items():
        shares = {
            int(label): n_rejected[labels == label].sum() / max(n_present[labels == label].sum(), 1)
            for label in np.unique(labels)
        }
        names = fitted.pose_names if kind == "pose" else {}
        bad = [names.get(label, str(label)) for label, share in shares.items() if share > CULPRIT_SHARE]
        if bad and len(bad) < len(shares):
            where = "board.buzzers in the rig description" if kind == "buzzer" else "what happened there"
            return f", most of those of {kind} {' and '.join(bad[:4])}: check {where}"
    if fitted.residuals_s.shape[1] <= FEW_PAIRS:
        return ": of three microphones, one that is wrong spoils the others: leave fewer channels out"
    return ": check the room for noise and echo, and the rig description"
