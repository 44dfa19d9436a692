"""Arrivals in a session's sound, each with its standard deviation, and what is wrong with those that have none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.background import listen
from calib.consistency import agree
from calib.errors import NotEnoughDataError
from calib.flaws import Flaw, Flaws
from calib.gcc import PairCorrelator, joined
from calib.receptions import MIN_HEIGHT, SILENT_RMS, Listener, Receptions, find_flaws
from calib.windows import EmissionWindows
from rigs.session.reader import Session
from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]
RowArray = NDArray[np.intp]

TdoaMode = Literal["auto", "matched", "gcc-phat"]

LOUD_RATIO = 1.5  # of an emission's samples over the background: it was heard
LEAST_ONSET_STD_S = 1e-8
MIN_QUALITY = 0.5  # of an emission's pairs must agree


@dataclass(frozen=True)
class SoundArrivals:
    """Arrivals of some emissions.

    Parameters
    ----------
    mode : {"matched", "gcc-phat"}
        How they were measured.
    rows : (n_emissions,) integer array
        Of the session's table of emissions.
    channels : tuple of int
        Input channel of each microphone.
    arrival_s : (n_emissions, n_channels) array
        Since the session's first sample ("matched"), or since the mean over the channels ("gcc-phat"); NaN where
        there is none, or it was rejected.
    std_s : (n_emissions, n_channels) array
    flaws : Flaws
    quality : (n_emissions,) array
        Share of the channels ("matched") or pairs ("gcc-phat") that agree on one source.
    onset_s, onset_std_s : (n_emissions,) arrays or None
        When the trigger board's sync output began, on the axis of the arrivals, but for a delay common to all; NaN
        where it was not seen. None where it was not recorded, or arrivals have no common axis.
    """

    mode: str
    rows: RowArray
    channels: tuple[int, ...]
    arrival_s: FloatArray
    std_s: FloatArray
    flaws: Flaws
    quality: FloatArray
    onset_s: FloatArray | None = None
    onset_std_s: FloatArray | None = None


class Ear:
    """Hears a growing session's emissions, each once: what was heard before is kept.

    What the buzzers sound like is learnt from the emissions of the first time.

    Parameters
    ----------
    mode : {"auto", "matched", "gcc-phat"}
    """

    def __init__(self, mode: TdoaMode) -> None:
        self._mode = mode
        self._microphones, self._sync = _Hearing(), _Hearing()

    def hear(self, session: Session, rows: RowArray) -> SoundArrivals:
        """Find the arrivals of some emissions (n,); where the first are not those of the last time, it begins anew.

        Raises
        ------
        NotEnoughDataError
            As `find_arrivals` does.
        """
        waveform = session.description.signal.waveform()
        wrong = _checked_labels(session, rows, waveform)
        if not _is_known(self._mode, wrong):
            return _correlated(session, rows, waveform)
        windows = windows_of(session, rows, waveform)
        listener, receptions = self._microphones.hear(session, rows, windows, wrong, session.emissions["buzzer"][rows])
        arrivals = _judged(session, rows, windows, listener, receptions, wrong)
        if session.description.audio.sync_channel is None:
            return arrivals
        windows = windows_of(session, rows, waveform, (session.n_channels - 1,))
        one_pin = np.zeros(len(rows), dtype=np.int32)
        _, receptions = self._sync.hear(session, rows, windows, wrong, one_pin)
        return _with_onsets(arrivals, windows, receptions)


class _Hearing:
    """Finds emissions in some channels, and remembers those found."""

    def __init__(self) -> None:
        self._rows = np.array([], dtype=np.intp)
        self._listener: Listener | None = None
        self._receptions: Receptions | None = None

    def hear(
        self,
        session: Session,
        rows: RowArray,
        windows: EmissionWindows,
        wrong: NDArray[np.bool_],
        buzzer: NDArray[np.int32],
    ) -> tuple[Listener, Receptions]:
        if not np.array_equal(rows[: len(self._rows)], self._rows):
            self._listener = self._receptions = None
        self._rows = rows
        if self._listener is None:
            self._listener = learn(session, rows, windows, wrong, buzzer)
        else:
            self._listener = self._listener.among(windows, buzzer)
        self._receptions = self._listener.hear(session.description.capture.clip_level, self._receptions)
        return self._listener, self._receptions


def find_arrivals(session: Session, rows: RowArray, mode: TdoaMode) -> SoundArrivals:
    """Find the arrivals of some emissions (n,) of a session.

    Raises
    ------
    NotEnoughDataError
        The waveform is a steady tone, or most emissions played something else than the rig description says.
    """
    return Ear(mode).hear(session, rows)


def _checked_labels(session: Session, rows: RowArray, waveform: Waveform) -> NDArray[np.bool_]:
    if waveform.kind == "tone":
        raise NotEnoughDataError(
            "a steady tone leaves arrivals ambiguous by whole periods, so no TDOA is measured in it: capture again "
            "with signal.kind sweep or mls in the rig description"
        )
    return wrong_labels(session, rows, waveform)


def _is_known(mode: TdoaMode, wrong: NDArray[np.bool_]) -> bool:
    """Tell whether the known waveform is looked for."""
    return mode == "matched" or (mode == "auto" and wrong.mean() <= 0.5)


def wrong_labels(session: Session, rows: RowArray, waveform: Waveform) -> NDArray[np.bool_]:
    """Tell which emissions (n,) played something else than a waveform."""
    return np.array(
        [label.decode(errors="replace") != waveform.label() for label in session.emissions["waveform"][rows]]
    )


def windows_of(
    session: Session, rows: RowArray, waveform: Waveform, columns: tuple[int, ...] | None = None
) -> EmissionWindows:
    """Return the windows of some emissions (n,), in the microphones or in other columns of the sound."""
    tolerance_s = session.description.capture.onset_tolerance_s
    return EmissionWindows(
        session, session.emissions["expected_sample"][rows], waveform.duration_s, tolerance_s, columns
    )


def listener_of(
    session: Session, rows: RowArray, waveform: Waveform, wrong: NDArray[np.bool_]
) -> tuple[EmissionWindows, Listener]:
    """Return windows of some emissions (n,), and a listener that has learnt from them.

    Raises
    ------
    NotEnoughDataError
        All emissions played something else.
    """
    windows = windows_of(session, rows, waveform)
    return windows, learn(session, rows, windows, wrong, session.emissions["buzzer"][rows])


def learn(
    session: Session,
    rows: RowArray,
    windows: EmissionWindows,
    wrong: NDArray[np.bool_],
    buzzer: NDArray[np.int32],
) -> Listener:
    """Return a listener that has learnt from emissions (n,) of some buzzers.

    Raises
    ------
    NotEnoughDataError
        All emissions played something else.
    """
    waveform = session.description.signal.waveform()
    if wrong.all():
        played = {label.decode(errors="replace") for label in session.emissions["waveform"][rows]}
        raise NotEnoughDataError(
            f"the buzzers played {', '.join(sorted(played))}, the rig description says {waveform.label()}: capture "
            "again with one signal, or measure with --tdoa gcc-phat, which needs to know none"
        )
    max_tdoa_s = session.description.calibration.max_tdoa_s
    usable = ~wrong & (windows.held_samples() == windows.n_samples) & (windows.first_samples >= 0)
    return Listener(windows, buzzer, waveform, max_tdoa_s, usable if usable.any() else ~wrong)


def _with_onsets(arrivals: SoundArrivals, windows: EmissionWindows, receptions: Receptions) -> SoundArrivals:
    """Add what the sync output says of when emissions began."""
    peaks = receptions.peaks
    good = (peaks.height > MIN_HEIGHT) & ~receptions.not_numbers & (windows.held_samples() > 0)[:, None]
    onset_s, std_s = (
        np.where(good, value, np.nan)[:, 0] / windows.sample_rate_hz
        for value in (peaks.place_samples + windows.first_samples[:, None], peaks.std_samples)
    )
    return replace(arrivals, onset_s=onset_s, onset_std_s=np.maximum(std_s, LEAST_ONSET_STD_S))


def _judged(
    session: Session, rows: RowArray, windows: EmissionWindows, listener: Listener, receptions: Receptions,
    wrong: NDArray[np.bool_],
) -> SoundArrivals:  # fmt: skip
    """Keep the receptions that have no flaw."""
    max_tdoa_samples = session.description.calibration.max_tdoa_s * session.sample_rate_hz
    flaws = find_flaws(receptions, listener, windows, wrong, max_tdoa_samples)
    place = receptions.peaks.place_samples + windows.first_samples[:, None]
    return _kept("matched", rows, windows, place, receptions.peaks.std_samples, flaws, (~flaws.rejected).mean(axis=1))


def _kept(
    mode: str, rows: RowArray, windows: EmissionWindows, place: FloatArray, std: FloatArray, flaws: Flaws,
    quality: FloatArray,
) -> SoundArrivals:  # fmt: skip
    """Keep what was not rejected, in seconds."""
    arrival_s, std_s = (np.where(flaws.rejected, np.nan, value) / windows.sample_rate_hz for value in (place, std))
    return SoundArrivals(mode, rows, windows.channels, arrival_s, std_s, flaws, quality)


def _correlated(session: Session, rows: RowArray, waveform: Waveform) -> SoundArrivals:
    windows = windows_of(session, rows, waveform)
    background = listen(windows, np.arange(len(rows)))
    max_lag = session.description.calibration.max_tdoa_s * session.sample_rate_hz
    correlator = PairCorrelator(windows.n_samples, background.power, max_lag)
    shape = (len(rows), windows.n_channels)
    candidates, loud = [], np.zeros(shape, dtype=bool)
    clipped, not_numbers = np.zeros((2, *shape), dtype=bool)
    for sound in windows.batches(np.arange(len(rows))):
        candidates.append(correlator.candidates(sound.samples))
        loud[sound.rows] = sound.rms() > LOUD_RATIO * np.maximum(background.rms, SILENT_RMS)
        clipped[sound.rows] = sound.peak() >= session.description.capture.clip_level
        not_numbers[sound.rows] = sound.not_numbers
    found = agree(joined(candidates), correlator.pairs(windows.n_channels), windows.n_channels)
    flaws = Flaws(shape)
    flaws.add(Flaw.CUT_OFF, (windows.held_samples() < windows.n_samples)[:, None])
    flaws.add(Flaw.NOT_NUMBERS, not_numbers)
    flaws.add(Flaw.NOT_HEARD, ~loud)
    flaws.add(Flaw.NO_CONSISTENT_PATH, (found.quality < MIN_QUALITY)[:, None] | ~np.isfinite(found.arrivals))
    flaws.add(Flaw.CLIPPED, clipped)
    flaws.add(Flaw.HUM, background.humming)
    return _kept("gcc-phat", rows, windows, found.arrivals, found.std, flaws, found.quality)
