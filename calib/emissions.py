"""The TDOAs of a session's emissions: measured in its sound, or taken as the session begins with them."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from calib.arrivals import PulseCompressor
from calib.errors import NotEnoughDataError
from calib.tdoa import gcc_phat
from rigs.session.reader import Session
from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]

FLIGHT_S = 0.03  # sound takes that long over 10 m
ABSURD_TDOA_S = 1.0


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
    """

    pose: NDArray[np.int32]
    buzzer: NDArray[np.int32]
    tdoa_s: FloatArray
    pairs: NDArray[np.int32]
    warnings: list[str] = field(default_factory=list)


def measure_tdoas(session: Session) -> EmissionTdoas:
    """Measure the TDOAs of all accepted emissions of accepted poses.

    Raises
    ------
    NotEnoughDataError
        There are no such emissions, or none was heard.
    """
    poses = [row["pose"] for row in session.poses if row["accepted"]]
    rows = np.flatnonzero((session.emissions["accepted"] == 1) & np.isin(session.emissions["pose"], poses))
    if len(rows) == 0:
        raise NotEnoughDataError("the session has no accepted emission: check the buzzers, then capture again")
    emissions = session.emissions[rows]
    measured = session.tdoas
    if measured is not None:
        tdoa_s = measured.tdoa_s[rows]
        tdoa_s = np.where(np.abs(tdoa_s) < ABSURD_TDOA_S, tdoa_s, np.nan)
        return EmissionTdoas(emissions["pose"], emissions["buzzer"], tdoa_s, measured.pairs)
    tdoa_s, pairs, warnings = _from_sound(session, emissions)
    return EmissionTdoas(emissions["pose"], emissions["buzzer"], tdoa_s, pairs, warnings)


def _from_sound(session: Session, emissions: NDArray[np.void]) -> tuple[FloatArray, NDArray[np.int32], list[str]]:
    description, rate_hz = session.description, session.sample_rate_hz
    waveform, max_tdoa_s = description.signal.waveform(), description.calibration.max_tdoa_s
    if waveform.kind == "tone":
        raise NotEnoughDataError(
            "a steady tone leaves arrivals ambiguous by whole periods, so no TDOA is measured in it: capture again "
            "with signal.kind sweep or mls in the rig description"
        )
    _check_waveform(emissions, waveform)
    search_s = FLIGHT_S + description.capture.onset_tolerance_s
    n_samples = round((2 * search_s + waveform.duration_s) * rate_hz)
    compressor = PulseCompressor(waveform, rate_hz, n_samples, max_tdoa_s)
    channels = tuple(session.channels[column] for column in session.microphone_columns)
    columns = np.array(list(combinations(range(len(channels)), 2)), dtype=np.int32)
    tdoa_s = np.full((len(emissions), len(columns)), np.nan)
    heard = np.zeros((len(emissions), len(channels)), dtype=bool)
    clipped = np.zeros_like(heard)
    n_flawed = 0
    for row, emission in enumerate(emissions):
        window = _window(session, int(emission["expected_sample"]) - round(search_s * rate_hz), n_samples)
        flawed = ~np.isfinite(window).all(axis=0)
        n_flawed += int(flawed.any())
        clipped[row] = (np.abs(np.where(flawed, 0, window)) >= description.capture.clip_level).any(axis=0)
        tdoa_s[row], heard[row] = _tdoas_of(np.where(flawed, np.float32(0), window), compressor, columns)
    warnings = _unheard_channels(heard, channels) + _clipped_channels(clipped, channels)
    at_limit = float(np.mean(np.isnan(tdoa_s) & heard[:, columns].all(axis=2)))
    if at_limit > 0.02:
        warnings.append(
            f"{at_limit:.0%} of the TDOAs lie beyond calibration.max_tdoa_s, {max_tdoa_s:g} s: raise it in the rig "
            "description if microphones are further apart"
        )
    if n_flawed:
        warnings.append(f"{n_flawed} emissions have samples that are not numbers; those channels were left out there")
    return tdoa_s, np.array(channels, dtype=np.int32)[columns], warnings


def _check_waveform(emissions: NDArray[np.void], waveform: Waveform) -> None:
    """Refuse emissions that were something else than the rig description says.

    Raises
    ------
    NotEnoughDataError
    """
    played = {label.decode(errors="replace") for label in emissions["waveform"]}
    if played != {waveform.label()}:
        raise NotEnoughDataError(
            f"the buzzers played {', '.join(sorted(played))}, the rig description says {waveform.label()}: capture "
            "again with one signal"
        )


def _window(session: Session, first_sample: int, n_samples: int) -> NDArray[np.float32]:
    """Return samples (n_samples, n_microphones), silent where the session holds none."""
    begin, end = max(first_sample, 0), min(first_sample + n_samples, session.n_samples)
    columns = list(session.microphone_columns)
    window = np.zeros((n_samples, len(columns)), dtype=np.float32)
    if begin < end:
        window[begin - first_sample : end - first_sample] = session.audio(begin, end - begin)[:, columns]
    return window


def _tdoas_of(
    window: NDArray[np.float32], compressor: PulseCompressor, columns: NDArray[np.int32]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Measure one emission: TDOAs (n_pairs,) in seconds, NaN where one of the two was deaf, and who heard it."""
    arrivals = compressor.arrivals(window)
    heard = np.isfinite(arrivals.peak_samples)
    if heard.sum() < 2:
        return np.full(len(columns), np.nan), heard
    lags = gcc_phat(arrivals.cut_out(), columns, compressor.whitening, compressor.max_tdoa_samples)
    return np.where(heard[columns].all(axis=1), lags / compressor.sample_rate_hz, np.nan), heard


def _unheard_channels(heard: NDArray[np.bool_], channels: tuple[int, ...]) -> list[str]:
    """Say which channels heard little.

    Raises
    ------
    NotEnoughDataError
        A channel heard nothing at all.
    """
    shares = heard.mean(axis=0)
    deaf = [channel for channel, share in zip(channels, shares, strict=True) if share == 0]
    if len(deaf) == len(channels):
        raise NotEnoughDataError("no emission was heard by any microphone: check buzzers, gains and signal")
    return [
        f"channel {channel} heard only {share:.0%} of the emissions: check its cable and gain"
        for channel, share in zip(channels, shares, strict=True)
        if 0 < share < 0.9
    ] + [f"channel {channel} heard none of the emissions" for channel in deaf]


def _clipped_channels(clipped: NDArray[np.bool_], channels: tuple[int, ...]) -> list[str]:
    return [
        f"channel {channel} clipped in {share:.0%} of the emissions: turn its gain down and capture again"
        for channel, share in zip(channels, clipped.mean(axis=0), strict=True)
        if share > 0.02
    ]
