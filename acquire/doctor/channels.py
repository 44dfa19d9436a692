"""The channels: dead, clipped, weak, noisy, humming, inverted and doubled ones, by what they recorded."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from acquire.doctor.hearing import Hearing
from acquire.doctor.listening import Sounds
from acquire.doctor.row import Part, Row, State

FloatArray = NDArray[np.float64]
_DOUBLED = 0.98  # correlation of differences; two microphones 1 cm apart stay below 0.9
_UNLIKE_DB = 15.0  # so much weaker, louder or noisier than the median channel
_POOR_SNR_DB, _NO_SNR_DB = 15.0, 3.0
_CLIPPED_SHARE = 0.5
_HUM_HZ, _HARMONICS, _HUM_DB, _HUM_DBFS = (50.0, 60.0), 8, 10.0, -65.0
_DIRECT_S = (0.0005, 0.003)  # before and after the onset: sound before its echoes
_FEW_SIGNS = 0.8


def judge_channels(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Say what ails single channels and buzzers, or that nothing does."""
    rows = [
        *_unheard(sounds, hearing),
        *_clipped(hearing),
        *_doubled(sounds, hearing),
        *_inverted(sounds, hearing),
        *_unlike(hearing),
        *_poor(hearing),
        *_humming(sounds, hearing),
    ]
    if not rows:
        median_db = float(np.nanmedian(hearing.snr_db))
        yield _row(
            "microphones",
            State.OK,
            f"all {len(hearing.channels)} hear all {len(hearing.buzzers)} buzzers, {median_db:.0f} dB over the noise "
            "(median)",
            snr_db=median_db,
        )
    yield from rows


def _row(subject: str, state: State, finding: str, remedy: str = "", **figures: float) -> Row:
    return Row(Part.SOUND, subject, state, finding, remedy, figures)


def _unheard(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Name silent buzzers and dead channels, and what is left of pairs that do not hear one another."""
    heard = hearing.heard()
    if not heard.any():
        yield _row(
            "microphones",
            State.BAD,
            "none hears any buzzer",
            "check the buzzers' power, and that audio.device and audio.channels name the microphones",
        )
        return
    deaf, mute = ~heard.any(axis=1), ~heard.any(axis=0)
    for buzzer in np.flatnonzero(mute):
        yield _row(f"buzzer {hearing.buzzers[buzzer]}", State.BAD, "no microphone hears it", "check its cable and plug")
    for column in np.flatnonzero(deaf):
        yield _dead(sounds, hearing, int(column))
    for column in np.flatnonzero(~deaf):
        missed = np.flatnonzero(~heard[column] & ~mute)
        if len(missed):
            yield _row(
                f"channel {hearing.channels[column]}",
                State.LOOK,
                f"does not hear {_listed('buzzer', [hearing.buzzers[k] for k in missed])}",
                "its gain up, and nothing between it and the board",
            )


def _dead(sounds: Sounds, hearing: Hearing, column: int) -> Row:
    constant = np.ptp(sounds.samples[:, column]) == 0
    finding = "dead: it delivers one constant value" if constant else "dead: it hears no buzzer, only its own noise"
    remedy = "check its cable, power and mute switch" + (
        ", and that audio.channels names an input that is there" if constant else ""
    )
    noise_dbfs = float(hearing.noise_dbfs[column])
    return _row(f"channel {hearing.channels[column]}", State.BAD, finding, remedy, noise_dbfs=noise_dbfs)


def _clipped(hearing: Hearing) -> Iterator[Row]:
    for column in np.flatnonzero(hearing.clipped.any(axis=1)):
        share = float(hearing.clipped[column].mean())
        state = State.BAD if share > _CLIPPED_SHARE else State.LOOK
        finding = f"clipped by {hearing.clipped[column].sum()} of {len(hearing.buzzers)} buzzers"
        yield _row(f"channel {hearing.channels[column]}", state, finding, "turn its gain down", clipped_share=share)


def _doubled(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Name channels that record the same, noise included."""
    steps = np.diff(sounds.samples.astype(float), axis=0)
    norms = np.linalg.norm(steps, axis=0)
    correlation = steps.T @ steps / np.maximum(np.outer(norms, norms), _tiny(norms))
    for first, second in zip(*np.triu_indices(len(norms), k=1), strict=True):
        r = float(correlation[first, second])
        if abs(r) > _DOUBLED:
            same = "record the same" if r > 0 else "record the same, one of them inverted"
            yield _row(
                f"channels {hearing.channels[first]}, {hearing.channels[second]}",
                State.BAD,
                f"{same} (correlation {r:.3f})",
                "check for one microphone on two inputs, a mono or monitor mix, and audio.channels",
                correlation=r,
            )


def _tiny(norms: FloatArray) -> float:
    return 1e-12 * max(float(norms.max()) ** 2, 1e-30)


def _inverted(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Name channels whose direct sound has the sign against the others, for nearly all buzzers."""
    signs = _signs(sounds, hearing)
    votes = np.nanmean(np.where(np.isnan(signs).all(axis=1, keepdims=True), 0.0, signs), axis=1)
    minority = votes < -_FEW_SIGNS if np.sum(votes > _FEW_SIGNS) > np.sum(votes < -_FEW_SIGNS) else votes > _FEW_SIGNS
    for column in np.flatnonzero(minority):
        yield _row(
            f"channel {hearing.channels[column]}",
            State.LOOK,
            "inverted against most others",
            "check the polarity of its cable (hot and cold swapped); calibration does not mind, beamforming does",
        )


def _signs(sounds: Sounds, hearing: Hearing) -> FloatArray:
    """Return the sign (n_channels, n_buzzers) of each direct sound against the one of the loudest channel."""
    rate_hz = hearing.sample_rate_hz
    before, after = (round(each * rate_hz) for each in _DIRECT_S)
    signs = np.full(hearing.onset_s.shape, np.nan)
    for k, start in enumerate(sounds.starts):
        onsets = start + hearing.onset_s[:, k] * rate_hz
        columns = [int(column) for column in np.flatnonzero(np.isfinite(onsets) & (onsets > before))]
        direct = {c: sounds.samples[round(onsets[c]) - before : round(onsets[c]) + after, c] for c in columns}
        if not direct:
            continue
        model = direct[
            min(direct, key=lambda c: abs(hearing.level_dbfs[c, k] - np.nanmedian(hearing.level_dbfs[:, k])))
        ]
        for column, sound in direct.items():
            likeness = np.correlate(sound, model, mode="full")
            signs[column, k] = np.sign(likeness[np.argmax(np.abs(likeness))])
    return signs


def _unlike(hearing: Hearing) -> Iterator[Row]:
    """Name channels and buzzers that are much weaker or louder than the others."""
    level_dbfs = np.where(hearing.heard(), hearing.level_dbfs, np.nan)
    for axis, noun, numbers in ((1, "channel", hearing.channels), (0, "buzzer", hearing.buzzers)):
        heard = np.isfinite(level_dbfs).any(axis=axis)
        typical_dbfs = np.full(heard.shape, np.nan)
        typical_dbfs[heard] = np.nanmedian(np.compress(heard, level_dbfs, axis=1 - axis), axis=axis)
        if not heard.any():
            continue
        off_db = typical_dbfs - np.nanmedian(typical_dbfs)
        for k in np.flatnonzero(np.abs(np.nan_to_num(off_db)) > _UNLIKE_DB):
            how = "weaker" if off_db[k] < 0 else "louder"
            remedy = "set its gain as the others'" if noun == "channel" else "check its plug and what covers it"
            finding = f"{abs(off_db[k]):.0f} dB {how} than the others"
            yield _row(f"{noun} {numbers[k]}", State.LOOK, finding, remedy, off_db=float(off_db[k]))


def _poor(hearing: Hearing) -> Iterator[Row]:
    """Name channels that are noisy, or hear too little over their noise."""
    off_db = hearing.noise_dbfs - np.median(hearing.noise_dbfs)
    for column, channel in enumerate(hearing.channels):
        if not hearing.heard()[column].any():
            continue
        snr_db, noise_dbfs = float(np.nanmedian(hearing.snr_db[column])), float(hearing.noise_dbfs[column])
        figures = {"snr_db": snr_db, "noise_dbfs": noise_dbfs}
        if snr_db < _POOR_SNR_DB:
            state = State.BAD if snr_db < _NO_SNR_DB else State.LOOK
            finding = f"hears the buzzers only {snr_db:.0f} dB over its noise of {noise_dbfs:.0f} dBFS"
            yield _row(f"channel {channel}", state, finding, "a quieter room, louder buzzers, or more gain", **figures)
        elif off_db[column] > _UNLIKE_DB:
            finding = f"noise of {noise_dbfs:.0f} dBFS, {off_db[column]:.0f} dB more than the others"
            yield _row(f"channel {channel}", State.LOOK, finding, "check its cable, shield and gain", **figures)


def _humming(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    quiet = sounds.samples[: sounds.quiet_end].astype(float)
    power = np.abs(np.fft.rfft((quiet - quiet.mean(axis=0)) * np.hanning(len(quiet))[:, None], axis=0)) ** 2
    frequency_hz = np.fft.rfftfreq(len(quiet), 1 / hearing.sample_rate_hz)
    for mains_hz in _HUM_HZ:
        harmonic = np.round(frequency_hz / mains_hz)
        near = (np.abs(frequency_hz - harmonic * mains_hz) < 2.5) & (harmonic >= 1) & (harmonic <= _HARMONICS)
        hum = power[near].sum(axis=0)
        ratio_db = 10 * np.log10(np.maximum(hum, 1e-30) / np.maximum(power[~near].sum(axis=0), 1e-30))
        for column in np.flatnonzero((ratio_db > _HUM_DB) & (hearing.noise_dbfs > _HUM_DBFS)):
            yield _row(
                f"channel {hearing.channels[column]}",
                State.LOOK,
                f"hums at {mains_hz:.0f} Hz ({hearing.noise_dbfs[column]:.0f} dBFS)",
                "check its shield and ground; keep it away from power supplies",
                hum_dbfs=float(hearing.noise_dbfs[column]),
            )


def _listed(noun: str, numbers: list[int]) -> str:
    return f"{noun}{'s' if len(numbers) > 1 else ''} {', '.join(str(number) for number in numbers)}"
