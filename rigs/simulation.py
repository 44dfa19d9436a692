"""The simulation section of a rig description: the room, how far devices are from ideal, and the faults they make."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from rigs.section import Channel, Section

RoomSide = Annotated[float, Field(ge=2, le=50)]


class Fault(Section):
    """A fault that the simulated rig makes, to try what the software does about it."""

    kind: Literal[
        "dead_channel", "silent_buzzer", "loud_channel", "audio_overflow", "board_moves", "trigger_lost", "audio_lost",
        "camera_lost", "trigger_reset", "camera_frozen", "clock_jump",
        "weak_channel", "noisy_channel", "humming_channel", "inverted_channel", "duplicate_channel", "swapped_channel",
        "moved_channel",
        "blurred", "overexposed",
    ]  # fmt: skip
    channel: Channel | None = Field(
        None, description="faults of a channel: which (and the next one, where it takes two)"
    )
    buzzer: int | None = Field(None, ge=1, le=255, description="silent_buzzer: which")
    pose: int = Field(0, ge=0, description="the first pose (counted from 0) at which it happens")
    duration_s: float | None = Field(None, gt=0, description="trigger_lost, audio_lost, camera_lost: for how long")

    @model_validator(mode="after")
    def _names_what_it_hits(self) -> Fault:
        if self.kind.endswith("_channel") and self.channel is None:
            raise ValueError(f"fault {self.kind} needs a channel: add 'channel: 3'")
        if self.kind == "silent_buzzer" and self.buzzer is None:
            raise ValueError("fault silent_buzzer needs a buzzer: add 'buzzer: 2'")
        return self


class Simulation(Section):
    """The simulated room, and how the simulated devices differ from ideal ones."""

    seed: int = Field(0, ge=0, le=2**63 - 1)
    visit: int = Field(0, ge=0, le=1000, description="a later visit to the same rig: other board positions, other air")
    room_size_m: tuple[RoomSide, RoomSide, RoomSide] = (5.2, 4.3, 2.9)
    rt60_s: float = Field(0.3, ge=0, le=5, description="time in which the room's echo falls by 60 dB; 0: no echo")
    snr_db: float = Field(35.0, ge=-20, le=120, description="of the direct sound at 1 m over the microphones' noise")
    image_noise: float = Field(2.0, ge=0, le=100, description="standard deviation of a pixel, of 255")
    faults: tuple[Fault, ...] = ()
