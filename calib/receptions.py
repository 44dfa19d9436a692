"""Arrivals of a session whose waveform is known: noise, responses, matched filters, and a verdict on each."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from calib.background import Background, listen
from calib.flaws import Flaw, Flaws
from calib.matched import MatchedFilter, Peaks
from calib.response import Response, ResponseLearner
from calib.windows import EmissionWindows
from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MIN_HEIGHT = 7.0  # over the noise: of ten thousand samples the highest reaches 4.5
AMBIGUITY_SIGMAS = 5.0
DISTURBED_RATIO = 2.5
USUAL_ECHO_SHARE = 0.3
ECHO_EMISSIONS = 6  # per buzzer, to tell echo from direct sound
SECOND_SHARE, SECOND_RATIO = 0.5, 2.0  # of the direct sound; over what is usual in the session
SPREAD_RATIO = 20.0
LOUDER_RATIO = 2.0
MOST_CHANNELS = 0.6
INVERTED_SHARE = 0.5
DEAD_SHARE = 0.95
SILENT_RMS = 1e-8  # of full scale: no microphone is that quiet


@dataclass(frozen=True)
class Receptions:
    """What was found in every emission and channel.

    Parameters
    ----------
    peaks : Peaks
        Of (n_emissions, n_channels).
    clipped, not_numbers : (n_emissions, n_channels) bool arrays
    level : (n_emissions, n_channels) array
        Root mean square of the windows.
    """

    peaks: Peaks
    clipped: BoolArray
    not_numbers: BoolArray
    level: FloatArray


class Listener:
    """Knows how a session's buzzers sound and finds them.

    Parameters
    ----------
    windows : EmissionWindows
    buzzer : (n_emissions,) integer array
    waveform : Waveform
    max_tdoa_s : float
    usable : (n_emissions,) bool array
        Which emissions may be learnt from.

    Attributes
    ----------
    background : Background
    echo_share : float
        Power of the session's echo over its direct sound.
    """

    def __init__(
        self,
        windows: EmissionWindows,
        buzzer: NDArray[np.integer],
        waveform: Waveform,
        max_tdoa_s: float,
        usable: BoolArray,
    ) -> None:
        self._windows, self._buzzer = windows, buzzer
        self._max_tdoa_samples = max_tdoa_s * windows.sample_rate_hz
        self.background = listen(windows, np.flatnonzero(usable))
        learner = ResponseLearner(windows, waveform, self.background, max_tdoa_s)
        learnt = {int(one): learner.learn(np.flatnonzero(usable & (buzzer == one))) for one in np.unique(buzzer)}
        self._responses = {one: response for one, response in learnt.items() if response is not None}
        self._amplitudes = _usual_amplitudes(list(self._responses.values()), windows.n_channels)
        self.echo_share = self._measure_echo(usable)
        self._filters = {one: self._filter(response, self.echo_share) for one, response in self._responses.items()}

    def filter(self, buzzer: int) -> MatchedFilter | None:
        """Return the filter for a buzzer, None for one that was never heard."""
        return self._filters.get(buzzer)

    def among(self, windows: EmissionWindows, buzzer: NDArray[np.integer]) -> Listener:
        """Return a listener that knows the same and finds other emissions, the first of which are those of this one."""
        other = copy(self)
        other._windows, other._buzzer = windows, buzzer
        return other

    def hear(self, clip_level: float, before: Receptions | None = None) -> Receptions:
        """Find all emissions, but for the first ones, where they were found before."""
        n_before = 0 if before is None else len(before.level)
        shape = (len(self._buzzer), self._windows.n_channels)
        table = {one.name: np.full(shape, np.nan) for one in fields(Peaks)}
        clipped, not_numbers, level = np.zeros(shape, bool), np.zeros(shape, bool), np.zeros(shape)
        if before is not None:
            for name, column in table.items():
                column[:n_before] = getattr(before.peaks, name)
            clipped[:n_before], not_numbers[:n_before], level[:n_before] = (
                before.clipped, before.not_numbers, before.level,
            )  # fmt: skip
        new = np.arange(len(self._buzzer)) >= n_before
        for buzzer in np.unique(self._buzzer[new]):
            matched = self.filter(int(buzzer))
            for sound in self._windows.batches(np.flatnonzero(new & (self._buzzer == buzzer))):
                not_numbers[sound.rows] = sound.not_numbers
                level[sound.rows] = sound.rms()
                clipped[sound.rows] = sound.peak() >= clip_level
                if matched is not None:
                    peaks = matched.peaks(sound)
                    for name, column in table.items():
                        column[sound.rows] = getattr(peaks, name)
        return Receptions(Peaks(**table), clipped, not_numbers, level)

    def lobes(self) -> FloatArray:
        """Return how high (n_emissions, n_channels) the filtered pulse's next swing is over its peak."""
        out = np.full((len(self._buzzer), self._windows.n_channels), np.nan)
        for buzzer, matched in self._filters.items():
            out[self._buzzer == buzzer] = matched.lobe
        return out

    def _filter(self, response: Response, echo_share: float) -> MatchedFilter:
        return MatchedFilter(
            response.spectrum, self._amplitudes, self.background, echo_share, self._windows, self._max_tdoa_samples
        )

    def _measure_echo(self, usable: BoolArray) -> float:
        shares = []
        for buzzer, response in self._responses.items():
            matched = self._filter(response, USUAL_ECHO_SHARE)
            rows = np.flatnonzero(usable & (self._buzzer == buzzer))
            rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), ECHO_EMISSIONS)).astype(int)]
            shares += [matched.echo_share(sound).ravel() for sound in self._windows.batches(rows)]
        found = np.concatenate(shares) if shares else np.array([])
        found = found[np.isfinite(found)]
        return float(np.clip(np.median(found), 1e-6, 1.0)) if len(found) else USUAL_ECHO_SHARE


def find_flaws(
    receptions: Receptions,
    listener: Listener,
    windows: EmissionWindows,
    wrong_label: BoolArray,
    max_tdoa_samples: float,
) -> Flaws:
    """Judge every arrival, in the order in which one flaw explains another."""
    peaks, flaws = receptions.peaks, Flaws(receptions.clipped.shape)
    flaws.add(Flaw.WRONG_WAVEFORM, wrong_label[:, None])
    flaws.add(Flaw.CUT_OFF, _cut_off(peaks, windows))
    flaws.add(Flaw.NOT_NUMBERS, receptions.not_numbers)
    heard = (peaks.height > MIN_HEIGHT) & ~flaws.rejected
    flaws.add(Flaw.DEAD_CHANNEL, _dead_channels(heard, flaws.rejected, listener.background))
    for original, twin in listener.background.twins():
        if not flaws.table[Flaw.DEAD_CHANNEL][:, [original, twin]].any():
            flaws.add(Flaw.COPIED_CHANNEL, np.arange(flaws.shape[1]) == twin)
    louder = _most(_over_usual(receptions.level, heard) > LOUDER_RATIO, ~flaws.rejected)
    spread_out = _spread_out(peaks, heard)
    flaws.add(Flaw.WRONG_WAVEFORM, (spread_out & ~louder)[:, None])
    flaws.add(Flaw.NOT_HEARD, ~heard)
    flaws.add(Flaw.TWO_SOURCES, _two_sources(peaks, heard & ~flaws.rejected)[:, None])
    flaws.add(Flaw.AMBIGUOUS, (1 - listener.lobes()) * peaks.height < AMBIGUITY_SIGMAS)
    flaws.add(Flaw.NO_CONSISTENT_PATH, _far_from_the_rest(peaks, flaws.rejected, max_tdoa_samples))
    flaws.add(Flaw.CLIPPED, receptions.clipped)
    flaws.add(Flaw.INVERTED, _inverted(peaks, flaws.rejected))
    flaws.add(Flaw.HUM, listener.background.humming)
    disturbed = heard & (_over_usual(peaks.disturbance, heard) > DISTURBED_RATIO)
    flaws.add(Flaw.DISTURBED, disturbed | (spread_out & louder)[:, None])
    return flaws


def _usual_amplitudes(responses: list[Response], n_channels: int) -> FloatArray:
    """Return the usual amplitudes (n_channels,) of the channels, the median where one never heard anything."""
    if not responses:
        return np.ones(n_channels)
    every = np.abs(np.concatenate([response.amplitudes for response in responses]))
    usual = np.array([np.median(column[np.isfinite(column)]) if np.isfinite(column).any() else 0 for column in every.T])
    return np.where(usual > 0, usual, np.median(usual[usual > 0]))


def _cut_off(peaks: Peaks, windows: EmissionWindows) -> BoolArray:
    held = windows.held_samples()[:, None]
    ends = np.where(np.isfinite(peaks.place_samples), peaks.place_samples, 0.0) + windows.n_played
    expected_end = windows.n_samples // 2 + windows.n_played // 2
    return np.asarray((held < windows.n_samples) & ((ends > held) | (held < expected_end)))


def _dead_channels(heard: BoolArray, rejected: BoolArray, background: Background) -> BoolArray:
    """Tell which channels (n_channels,) carry nothing, or nothing of what others hear."""
    others = heard.mean(axis=1) > 0.5
    asked = (~rejected & others[:, None]).sum(axis=0)
    missed = (~rejected & others[:, None] & ~heard).sum(axis=0)
    return np.asarray((background.rms < SILENT_RMS) | ((asked >= 3) & (missed > DEAD_SHARE * asked)))


def _over_usual(values: FloatArray, heard: BoolArray) -> FloatArray:
    """Divide values (n_emissions, n_channels) by the channel's median over what was heard."""
    shown = np.where(heard, values, np.nan)
    usual = [np.median(column[np.isfinite(column)]) if np.isfinite(column).any() else 1.0 for column in shown.T]
    return np.asarray(values / np.maximum(usual, 1e-12))


def _most(mask: BoolArray, among: BoolArray) -> BoolArray:
    """Tell of which emissions most channels are in the mask, among those that count."""
    counted = among.sum(axis=1)
    return np.asarray((counted > 1) & ((mask & among).sum(axis=1) > MOST_CHANNELS * counted))


def _spread_out(peaks: Peaks, heard: BoolArray) -> BoolArray:
    """Tell which emissions (n_emissions,) are loud and yet make no pulse: something else was played."""
    loud = peaks.height * np.sqrt(np.maximum(peaks.echo, 0.0)) > MIN_HEIGHT
    return _most(_over_usual(peaks.echo, heard) > SPREAD_RATIO, loud)


def _two_sources(peaks: Peaks, heard: BoolArray) -> BoolArray:
    """Tell in which emissions (n_emissions,) most channels hear two strong sounds, unlike in others."""
    strong = (peaks.second > SECOND_SHARE) & (_over_usual(peaks.second, heard) > SECOND_RATIO)
    return _most(strong, heard)


def _far_from_the_rest(peaks: Peaks, rejected: BoolArray, max_tdoa_samples: float) -> BoolArray:
    """Tell which arrivals are further from the median of the others than sound can be."""
    place = np.where(rejected, np.nan, peaks.place_samples)
    some = np.isfinite(place).any(axis=1)
    place = place[some]
    far = np.zeros(rejected.shape, dtype=bool)
    far[some] = np.abs(place - np.nanmedian(place, axis=1, keepdims=True)) > max_tdoa_samples
    return far


def _inverted(peaks: Peaks, rejected: BoolArray) -> BoolArray:
    """Tell which channels (n_channels,) have the other sign than most."""
    sign = np.where(rejected, 0.0, np.sign(np.nan_to_num(peaks.amplitude)))
    sign *= np.sign(sign.sum(axis=1, keepdims=True))  # that of a learnt response is anyone's choice
    return np.asarray(sign.sum(axis=0) < -INVERTED_SHARE * np.abs(sign).sum(axis=0))
