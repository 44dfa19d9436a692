"""The TDOAs of a session's emissions: measured in its sound, or taken as the session begins with them."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from calib.cache import ArrivalCache
from calib.errors import NotEnoughDataError
from calib.flaws import HARMLESS, OF_CHANNELS, Flaw
from calib.sound import Ear, SoundArrivals, TdoaMode, find_arrivals
from rigs.session.reader import Session

FloatArray = NDArray[np.float64]
RowArray = NDArray[np.intp]

ABSURD_TDOA_S = 1.0
NOTABLE_SHARE = 0.02
OFTEN = 0.1


@dataclass(frozen=True)
class EmissionTdoas:
    """TDOAs of the accepted emissions.

    Parameters
    ----------
    pose, buzzer : (n_emissions,) integer arrays
        The session's number of the pose, and the buzzer's id.
    tdoa_s : (n_emissions, n_pairs) array
        Arrival at j minus arrival at i; NaN where not heard.
    pairs : (n_pairs, 2) integer array
        Input channels (i, j).
    warnings : list of str
    sound : SoundArrivals or None
        What they were measured from; None where the session begins with them.
    session : (n_emissions,) integer array or None
        Which of several sessions each is of; None: there is one only.
    pose_names : dict of int to str
        What poses are called where not by their number.
    rows : (n_emissions,) integer array or None
        Of the session's table.
    """

    pose: NDArray[np.int32]
    buzzer: NDArray[np.int32]
    tdoa_s: FloatArray
    pairs: NDArray[np.int32]
    warnings: list[str] = field(default_factory=list)
    sound: SoundArrivals | None = None
    session: RowArray | None = None
    pose_names: dict[int, str] = field(default_factory=dict)
    rows: RowArray | None = None

    def pose_name(self, row: int) -> int | str:
        """Return what the pose of an emission is called."""
        pose = int(self.pose[row])
        return self.pose_names.get(pose, pose)

    def number(self, row: int) -> int | None:
        """Return the number of an emission in its session's table, where it is known."""
        return None if self.rows is None else int(self.rows[row])


def accepted_rows(session: Session) -> RowArray:
    """Return the rows of the accepted emissions of accepted poses.

    Raises
    ------
    NotEnoughDataError
        There are none.
    """
    poses = [row["pose"] for row in session.poses if row["accepted"]]
    rows = np.flatnonzero((session.emissions["accepted"] == 1) & np.isin(session.emissions["pose"], poses))
    if len(rows) == 0:
        raise NotEnoughDataError("the session has no accepted emission: check the buzzers, then capture again")
    return rows


def measure_tdoas(
    session: Session, mode: TdoaMode = "auto", cache: ArrivalCache | None = None, ear: Ear | None = None
) -> EmissionTdoas:
    """Measure the TDOAs of all accepted emissions of accepted poses, or take the arrivals of an earlier run.

    Parameters
    ----------
    session : Session
    mode : {"auto", "matched", "gcc-phat"}
    cache : ArrivalCache or None
        Where the arrivals of an earlier run may be, and are left for the next.
    ear : Ear or None
        What remembers the emissions that were heard before.

    Raises
    ------
    NotEnoughDataError
        There are no such emissions, or none was heard.
    """
    rows = accepted_rows(session)
    emissions = session.emissions[rows]
    measured = session.tdoas
    if measured is not None:
        tdoa_s = measured.tdoa_s[rows]
        tdoa_s = np.where(np.abs(tdoa_s) < ABSURD_TDOA_S, tdoa_s, np.nan)
        return EmissionTdoas(emissions["pose"], emissions["buzzer"], tdoa_s, measured.pairs, rows=rows)
    sound = cache.load(rows, mode) if cache else None
    if sound is None:
        sound = ear.hear(session, rows) if ear else find_arrivals(session, rows, mode)
        if cache:
            cache.save(sound, mode)
    return tdoas_of(session, rows, sound)


def tdoas_of(session: Session, rows: RowArray, sound: SoundArrivals) -> EmissionTdoas:
    """Take the differences of arrivals at all pairs of channels.

    Raises
    ------
    NotEnoughDataError
        Nothing was heard.
    """
    if not np.isfinite(sound.arrival_s).any():
        reasons = ", ".join(sound.flaws.counts()) or "nothing"
        remedy = "check buzzers, gains and signal"
        if sound.mode == "gcc-phat":
            remedy = "GCC-PHAT needs less noise: leave --tdoa out, so that the known waveform is looked for"
        raise NotEnoughDataError(f"no emission was heard by any microphone ({reasons}): {remedy}")
    columns = np.array(list(combinations(range(len(sound.channels)), 2)), dtype=np.int32)
    tdoa_s = sound.arrival_s[:, columns[:, 1]] - sound.arrival_s[:, columns[:, 0]]
    limit_s = session.description.calibration.max_tdoa_s
    beyond = np.abs(tdoa_s) > limit_s
    warnings = [*_channel_warnings(sound), *_sync_warnings(session, sound), *_emission_warnings(sound)]
    if beyond.mean() > NOTABLE_SHARE:
        warnings.append(
            f"{beyond.mean():.0%} of the TDOAs lie beyond calibration.max_tdoa_s, {limit_s:g} s: raise it in the rig "
            "description if microphones are further apart"
        )
    emissions, pairs = session.emissions[rows], np.array(sound.channels, dtype=np.int32)[columns]
    tdoa_s = np.where(beyond, np.nan, tdoa_s)
    return EmissionTdoas(emissions["pose"], emissions["buzzer"], tdoa_s, pairs, warnings, sound, rows=rows)


def _channel_warnings(sound: SoundArrivals) -> list[str]:
    """Say what is wrong with single channels."""
    heard, flaws = np.isfinite(sound.arrival_s), sound.flaws
    warnings = []
    for column, channel in enumerate(sound.channels):
        share = float(heard[:, column].mean())
        if share == 0:
            why = "".join(f" ({flaw})" for flaw in flaws.of_channel(column) if flaw not in HARMLESS)
            warnings.append(
                f"channel {channel} heard none of the emissions{why} and has no position: check its cable, power and "
                "mute switch, then capture again"
            )
        elif share < 1 - OFTEN:
            warnings.append(f"channel {channel} heard only {share:.0%} of the emissions: check its cable and gain")
        if Flaw.INVERTED in flaws.of_channel(column):
            warnings.append(f"channel {channel}: polarity inverted, which does its arrivals no harm: check its wiring")
        if Flaw.HUM in flaws.of_channel(column):
            warnings.append(f"channel {channel}: hum of the mains is most of its noise: check its ground and cable")
    clipped = flaws.table.get(Flaw.CLIPPED, np.zeros(heard.shape)).mean(axis=0)
    warnings += [
        f"channel {channel} clipped in {share:.0%} of the emissions: turn its gain down and capture again"
        for channel, share in zip(sound.channels, clipped, strict=True)
        if share > NOTABLE_SHARE
    ]
    return warnings


def _sync_warnings(session: Session, sound: SoundArrivals) -> list[str]:
    """Say when the channel of the sync output does not carry it."""
    if sound.onset_s is None or np.isfinite(sound.onset_s).mean() > 1 - OFTEN:
        return []
    share, channel = np.isfinite(sound.onset_s).mean(), session.description.audio.sync_channel
    return [f"channel {channel} has the board's sync output in {share:.0%} of the emissions only: check its wire"]


def _emission_warnings(sound: SoundArrivals) -> list[str]:
    """Say what is wrong with whole emissions, or with many arrivals."""
    flaws = sound.flaws
    whole = [flaws.of_emission(row) for row in range(flaws.shape[0])]
    warnings = []
    for flaw in Flaw:
        n_whole = sum(flaw in found for found in whole)
        if n_whole and flaw not in OF_CHANNELS and (flaw != Flaw.NOT_HEARD or n_whole > OFTEN * len(whole)):
            warnings.append(f"{n_whole} of {len(whole)} emissions left out: {flaw}")
    not_numbers = flaws.table.get(Flaw.NOT_NUMBERS)
    if not_numbers is not None and not_numbers.any():
        n_flawed = int(not_numbers.any(axis=1).sum())
        warnings.append(f"{n_flawed} emissions have samples that are not numbers; those channels were left out there")
    disturbed = flaws.table.get(Flaw.DISTURBED)
    if disturbed is not None and disturbed.any(axis=1).mean() > OFTEN:
        share = disturbed.any(axis=1).mean()
        warnings.append(f"{share:.0%} of the emissions have {Flaw.DISTURBED}: keep the room quiet while buzzers sound")
    return warnings
