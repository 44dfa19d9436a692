"""The board's clock and the host's: offset and drift, from pings."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from acquire.devices.base import ClockFit, Ping

WRAP_US = 1 << 32
_KEPT = 64  # pings; older ones would see the resonator at another temperature
_RATE_STD = 0.005  # what a ceramic resonator may be off: holds the rate while the pings span little time
_RATE_LIMIT = 0.02
_NOISE_S = 0.0002  # of one good ping
_JUMP_S = 0.001  # a line this far outside of a ping's bounds is disproved
_SLACK_S = 0.0005  # a round trip longer than the quick quarter's by more than this was held up somewhere


class BoardClock:
    """Relates the board's 32-bit microseconds to the host's monotonic clock by a line through the quickest pings.

    A ping that no line through the earlier ones explains starts anew: the host slept, or a simulated board stood still.
    """

    def __init__(self) -> None:
        self._pings: deque[Ping] = deque(maxlen=_KEPT)
        self._line: tuple[float, float, float] | None = None  # board s, host s, board seconds per host second

    def add(self, earliest_s: float, latest_s: float, board_us: int) -> Ping:
        """Take in a ping and return it, its reading unrolled.

        Parameters
        ----------
        earliest_s, latest_s : float
            Host times between which the board read its clock.
        board_us : int
            What it read, modulo 2**32.
        """
        board_s = self.board_s(board_us, 0.5 * (earliest_s + latest_s)) if self._line else 1e-6 * board_us
        self._pings.append(Ping(earliest_s, latest_s, board_s))
        self._line = self._fitted()
        if not earliest_s - _JUMP_S < self.host_s(board_s) < latest_s + _JUMP_S:
            self._pings = deque([self._pings[-1]], maxlen=_KEPT)
            self._line = self._fitted()
        return self._pings[-1]

    @property
    def rate(self) -> float:
        """Seconds of the board per second of the host. Raises RuntimeError before the first ping."""
        return self._needed_line()[2]

    def board_s(self, board_us: int, near_host_s: float) -> float:
        """Return the unrolled time (s) of a reading taken near a host time: within 35 minutes will do."""
        board_s, host_s, rate = self._needed_line()
        expected_us = 1e6 * (board_s + rate * (near_host_s - host_s))
        return 1e-6 * (board_us + WRAP_US * round((expected_us - board_us) / WRAP_US))

    def host_s(self, board_s: float) -> float:
        """Return the host time (s) of an unrolled board time."""
        origin_board_s, origin_host_s, rate = self._needed_line()
        return origin_host_s + (board_s - origin_board_s) / rate

    def fit(self) -> ClockFit:
        """Return the line with its uncertainty. Raises RuntimeError before the first ping.

        A ping may be read anywhere in its round trip, the same way each time, so no number of pings makes the line
        better than a reading anywhere within the quick ones' round trip.
        """
        board_s, host_s, rate = self._needed_line()
        quick = self._quick()
        times_s = np.array([ping.middle_s for ping in quick])
        scatter_s = float(np.std([ping.middle_s - self.host_s(ping.board_s) for ping in quick]))
        anywhere_s = float(np.median([ping.round_trip_s for ping in quick])) / math.sqrt(12)
        noise_s = max(scatter_s, _NOISE_S)
        rate_std = noise_s / math.sqrt(float(np.sum((times_s - times_s.mean()) ** 2)) + (noise_s / _RATE_STD) ** 2)
        std_s = math.hypot(scatter_s, anywhere_s)
        return ClockFit(self._pings[0].earliest_s, host_s, board_s, rate, rate_std, std_s, len(self._pings))

    def residuals_s(self) -> NDArray[np.float64]:
        """Return host time by the pings minus host time by the line (n_pings,), of all pings that are kept."""
        return np.array([ping.middle_s - self.host_s(ping.board_s) for ping in self._pings])

    def _needed_line(self) -> tuple[float, float, float]:
        if self._line is None:
            raise RuntimeError("the board's clock was asked for before the first ping")
        return self._line

    def _quick(self) -> list[Ping]:
        limit_s = float(np.quantile([ping.round_trip_s for ping in self._pings], 0.25)) + _SLACK_S
        return [ping for ping in self._pings if ping.round_trip_s <= limit_s]

    def _fitted(self) -> tuple[float, float, float]:
        quick = self._quick()
        host_s = np.array([ping.middle_s for ping in quick])
        board_s = np.array([ping.board_s for ping in quick])
        mean_host_s, mean_board_s = float(host_s.mean()), float(board_s.mean())
        span_s, ahead_s = host_s - mean_host_s, board_s - mean_board_s
        prior_s2 = (_NOISE_S / _RATE_STD) ** 2
        rate = 1 + float(span_s @ (ahead_s - span_s)) / (float(span_s @ span_s) + prior_s2)
        return mean_board_s, mean_host_s, min(max(rate, 1 - _RATE_LIMIT), 1 + _RATE_LIMIT)
