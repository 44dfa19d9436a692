"""The clocks: audio samples, board events and frames on the host's monotonic clock, stored with what they rest on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from acquire.devices.base import AudioBlock, ClockFit, EmissionStart, Ping
from acquire.latency import Latency
from acquire.sample_clock import SampleClock
from rigs.description import RigDescription
from rigs.session import layout
from rigs.session.writer import SessionWriter


@dataclass(frozen=True)
class Prediction:
    """Where an emission should begin in the recording.

    Parameters
    ----------
    sample : float
        Row of the recording, with its fraction, by the clocks alone: without the latency.
    std_s : float
        Standard deviation of it.
    """

    sample: float
    std_s: float


class Clocks:
    """Follows each device's clock.

    Parameters
    ----------
    writer : SessionWriter
    description : RigDescription
    """

    def __init__(self, writer: SessionWriter, description: RigDescription) -> None:
        self._writer = writer
        self._nominal_hz = float(description.audio.sample_rate_hz)
        self._frame_s = 1 / description.camera.fps
        self._samples = SampleClock(self._nominal_hz)
        self.latency = Latency(description.capture.onset_tolerance_s)

    @property
    def is_in_doubt(self) -> bool:
        """Audio comes late, and it is not yet clear whether samples were lost."""
        return self._samples.is_in_doubt

    @property
    def is_settled(self) -> bool:
        """The stamps of the audio have kept step with its samples for a while."""
        return self._samples.is_settled

    def hear(self, first_sample: int, block: AudioBlock) -> float | None:
        """Take an audio block's stamp; return how many seconds are missing before it, as `SampleClock.add` does."""
        if block.flags & (layout.FLAG_OVERFLOW | layout.FLAG_GAP):
            self._samples.restart()
        return self._samples.add(first_sample, block.host_time_s)

    def missing_s(self, first_sample: int, block: AudioBlock) -> float:
        """Return how much sound (s) is missing before a block that says so; 0 where it does not, or nobody knows."""
        if not block.flags & (layout.FLAG_OVERFLOW | layout.FLAG_GAP):
            return 0.0
        sample = self._samples.sample_at(block.host_time_s)
        return 0.0 if sample is None else max(0.0, (sample - first_sample) / self._nominal_hz)

    def predict(self, start: EmissionStart) -> Prediction | None:
        """Return where in the recording an emission should begin, latency left out; None when that is unknown."""
        sample, fit = self._samples.sample_at(start.host_time_s), self._samples.fit()
        if sample is None or fit is None:
            return None
        return Prediction(sample, math.hypot(fit.std_s, start.host_std_s))

    def store(self, pings: Sequence[Ping], board: ClockFit) -> None:
        """Store readings of the board's clock, and both lines as they are now."""
        for ping in pings:
            self._writer.append_ping(
                earliest_host_time_s=ping.earliest_s, latest_host_time_s=ping.latest_s, board_time_s=ping.board_s
            )
        self._store_fit(layout.CLOCK_BOARD, board)
        self._store_fit(layout.CLOCK_AUDIO, self._samples.fit())

    def store_camera(self, host_time_s: float) -> None:
        """Store what is known of the camera's times: its stamps are the host's own, its delay is not known."""
        fit = ClockFit(host_time_s, host_time_s, host_time_s, 1.0, 0.0, self._frame_s, 0)
        self._store_fit(layout.CLOCK_CAMERA, fit)

    def store_session(self) -> str | None:
        """Store the line over the longest stretch of the session, and say in words how fast it was sampled."""
        fit = self._samples.longest_fit()
        if fit is None:
            return None
        self._store_fit(layout.CLOCK_SESSION, fit)
        ppm = 1e6 * (fit.rate / self._nominal_hz - 1)
        return f"the sound device sampled at {fit.rate:.2f} Hz, {ppm:+.1f} +- {1e6 * fit.rate_std:.1f} ppm"

    def _store_fit(self, clock: bytes, fit: ClockFit | None) -> None:
        if fit is None:
            return
        self._writer.append_clock_fit(
            clock=clock,
            since_host_time_s=fit.since_s,
            host_time_s=fit.host_s,
            reading=fit.reading,
            rate=fit.rate,
            rate_std=fit.rate_std,
            std_s=fit.std_s,
            n_readings=fit.n_readings,
        )
