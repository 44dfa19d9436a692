"""The signals section of a rig description: what a buzzer plays, how often, and the silence after it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from rigs.section import Section
from rigs.waveform import Waveform


class SignalTiming(Section):
    """What all signals share."""

    gap_s: float = Field(0.4, ge=0.05, le=10, description="silence after each emission, longer than the room rings")
    repeats: int = Field(1, ge=1, le=100, description="emissions of each buzzer per pose")


class SweepSignal(SignalTiming):
    """A square wave that sweeps linearly."""

    kind: Literal["sweep"]
    start_hz: float = Field(1000.0, ge=50, le=40000)
    stop_hz: float = Field(8000.0, ge=50, le=40000)
    duration_s: float = Field(0.1, ge=0.005, le=0.5)

    def waveform(self) -> Waveform:
        """Return what the buzzer plays."""
        return Waveform("sweep", self.duration_s, self.start_hz, self.stop_hz)


class MlsSignal(SignalTiming):
    """A maximum-length sequence."""

    kind: Literal["mls"]
    order: int = Field(10, ge=7, le=13)
    chip_rate_hz: float = Field(16000.0, ge=1000, le=80000)

    @model_validator(mode="after")
    def _short_enough(self) -> MlsSignal:
        duration_s = self.waveform().duration_s
        if duration_s > 0.5:
            raise ValueError(f"this sequence lasts {duration_s:.2f} s, the board's limit is 0.5 s: lower the order")
        return self

    def waveform(self) -> Waveform:
        """Return what the buzzer plays."""
        duration_s = (2**self.order - 1) / self.chip_rate_hz
        return Waveform("mls", duration_s, 0.0, self.chip_rate_hz / 2, self.order, self.chip_rate_hz)


class ToneSignal(SignalTiming):
    """A steady tone: easy, but its arrival is ambiguous by whole periods."""

    kind: Literal["tone"]
    frequency_hz: float = Field(4000.0, ge=50, le=40000)
    duration_s: float = Field(0.1, ge=0.005, le=0.5)

    def waveform(self) -> Waveform:
        """Return what the buzzer plays."""
        return Waveform("tone", self.duration_s, self.frequency_hz, self.frequency_hz)


Signal = Annotated[SweepSignal | MlsSignal | ToneSignal, Field(discriminator="kind")]
