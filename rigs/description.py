"""The rig description: everything that a rig is, as a validated value.

Read it from the bottom: `RigDescription` holds one section per part of the rig. Lengths are metres, times seconds,
frequencies hertz, picture places pixels, temperatures degrees Celsius; the unit is part of every key.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from rigs.section import Channel, Section
from rigs.signals import Signal
from rigs.simulation import Simulation

MIN_POSES = 4  # that a session needs before it can be calibrated
MIN_POSES_FOR_INTRINSICS = 6  # where the camera's intrinsics are to be found from it, too

Length = Annotated[float, Field(gt=0, le=0.5)]
Coordinate = Annotated[float, Field(ge=-20, le=20)]
Position = tuple[Coordinate, Coordinate, Coordinate]
BoardCoordinate = Annotated[float, Field(ge=-2, le=2)]


class AudioDevice(Section):
    """Which sound device, by words of its name and its host API; never by a number that changes at boot."""

    name: str = Field(min_length=1, description="words of the device's name")
    host_api: str | None = Field(None, description="host API, such as ALSA, JACK, ASIO, Core Audio")


class ReferenceMicrophone(Section):
    """An extra microphone at a known place (method ours-3 needs it)."""

    channel: Channel = Field(description="input channel of the device, counted from 1")
    position_m: Position = Field(description="place in the camera frame")
    position_std_m: float = Field(0.001, ge=0, le=1, description="how well it is known: standard deviation per axis")


class Audio(Section):
    """The microphones' sound device."""

    driver: Literal["simulated", "portaudio"]
    device: AudioDevice | None = Field(None, description="which device (driver portaudio)")
    sample_rate_hz: int = Field(48000, ge=8000, le=384000)
    channels: tuple[Channel, ...] = Field(
        min_length=4, max_length=64, description="input channel of each microphone, counted from 1, microphone 1 first"
    )
    reference_microphone: ReferenceMicrophone | None = None
    expected_positions_m: tuple[Position, ...] | None = Field(
        None, description="about where each microphone is, in the camera frame: lets rig-check name swapped channels"
    )
    sync_channel: Channel | None = Field(
        None, description="input channel, counted from 1, that is wired to the trigger board's sync output"
    )

    @model_validator(mode="after")
    def _channels_differ(self) -> Audio:
        recorded = self.recorded_channels()
        twice = sorted({channel for channel in recorded if recorded.count(channel) > 1})
        if twice:
            raise ValueError(
                f"channel {twice[0]} is listed twice: every microphone, and the sync output, needs a channel of its own"
            )
        expected = self.expected_positions_m
        if expected is not None and len(expected) != len(self.channels):
            raise ValueError(f"expected_positions_m has {len(expected)} places, give one for each of audio.channels")
        if self.driver == "portaudio" and self.device is None:
            raise ValueError("driver portaudio needs a device: add 'device: {name: ...}'")
        return self

    def recorded_channels(self) -> tuple[int, ...]:
        """Return the input channels in the order of the columns of `time_data`: microphones, reference, sync output."""
        return self.microphone_channels() + (() if self.sync_channel is None else (self.sync_channel,))

    def microphone_channels(self) -> tuple[int, ...]:
        """Return the input channels of the microphones, the first columns of `time_data`; the reference is the last."""
        extra = (self.reference_microphone.channel,) if self.reference_microphone else ()
        return self.channels + extra


class Intrinsics(Section):
    """Pinhole camera with Brown-Conrady distortion, as OpenCV has it."""

    focal_px: tuple[float, float] = Field(description="focal lengths fx, fy")
    principal_px: tuple[float, float] = Field(description="principal point cx, cy")
    distortion: tuple[float, float, float, float, float] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0), description="k1, k2, p1, p2, k3"
    )

    @field_validator("focal_px")
    @classmethod
    def _focal_is_positive(cls, value: tuple[float, float]) -> tuple[float, float]:
        if min(value) <= 0:
            raise ValueError("focal lengths must be greater than 0 pixels")
        return value


def _intrinsics_branch(value: object) -> str:
    return "given" if isinstance(value, Mapping | Intrinsics) else "from session"


# The branch is chosen by what stands there, so that an error speaks of that branch only.
IntrinsicsOrFromSession = Annotated[
    Annotated[Intrinsics, Tag("given")] | Annotated[Literal["from session"], Tag("from session")],
    Discriminator(_intrinsics_branch),
]


class Exposure(Section):
    """Exposure, gain and focus, locked so that the intrinsics hold."""

    locked: bool = True
    exposure: float | None = Field(None, description="in the driver's own unit")
    gain: float | None = Field(None, ge=0, description="in the driver's own unit")
    focus: float | None = Field(None, ge=0, description="in the driver's own unit")


class Camera(Section):
    """The camera."""

    driver: Literal["simulated", "opencv"]
    source: str | int | None = Field(None, description="device number or path, address, file or folder (driver opencv)")
    size_px: tuple[Annotated[int, Field(ge=64, le=16384)], Annotated[int, Field(ge=64, le=16384)]]
    fps: float = Field(30.0, gt=0, le=1000)
    exposure: Exposure = Exposure()
    intrinsics: IntrinsicsOrFromSession = "from session"

    @model_validator(mode="after")
    def _source_is_given(self) -> Camera:
        if self.driver == "opencv" and self.source is None:
            raise ValueError("driver opencv needs a source: add 'source: 0' or a path or an address")
        return self


class Charuco(Section):
    """What a ChArUco board adds to a checkerboard."""

    dictionary: str = Field("DICT_5X5_100", description="OpenCV's name of it")
    marker_size_m: Length

    @field_validator("dictionary")
    @classmethod
    def _dictionary_is_known(cls, value: str) -> str:
        if not re.fullmatch(
            r"DICT_(([4-7])X\2_(50|100|250|1000)|ARUCO_ORIGINAL|APRILTAG_(16h5|25h9|36h10|36h11))", value
        ):
            raise ValueError(f"OpenCV has no dictionary {value!r}: give one such as DICT_5X5_100")
        return value


class Buzzer(Section):
    """A buzzer: its number at the trigger board and where the sound leaves it, in the board frame."""

    id: int = Field(ge=1, le=255, description="the trigger board's number of it, counted from 1")
    position_m: tuple[BoardCoordinate, BoardCoordinate, BoardCoordinate] = Field(
        description="place in the board frame (origin: first inner corner)"
    )


class Board(Section):
    """The target: a checkerboard or ChArUco board that carries the buzzers."""

    pattern: Literal["checkerboard", "charuco"]
    corners: tuple[Annotated[int, Field(ge=3, le=100)], Annotated[int, Field(ge=3, le=100)]] = Field(
        description="inner corners: columns, rows"
    )
    square_size_m: Length = Field(description="side of a square in metres, measured on the printed board")
    square_size_std_m: float = Field(
        0.0002, ge=0, le=0.01, description="how well it is known: standard deviation (measure over many squares)"
    )
    print_std_m: float = Field(
        0.0001, ge=0, le=0.01, description="how true the print is: standard deviation of a corner along the board"
    )
    flatness_std_m: float = Field(
        0.001, ge=0, le=0.05, description="how flat the board is: standard deviation of a corner across the board"
    )
    charuco: Charuco | None = None
    buzzers: tuple[Buzzer, ...] = Field(min_length=1, max_length=255)
    buzzer_std_m: float = Field(
        0.003, ge=0, le=0.05, description="how well the buzzers' places are known: standard deviation per axis"
    )

    @model_validator(mode="after")
    def _board_is_possible(self) -> Board:
        ids = [buzzer.id for buzzer in self.buzzers]
        twice = sorted({number for number in ids if ids.count(number) > 1})
        if twice:
            raise ValueError(f"buzzer {twice[0]} is listed twice: give each buzzer an id of its own")
        places = [buzzer.position_m for buzzer in self.buzzers]
        if len(set(places)) < len(places):
            raise ValueError("two buzzers are at the same place: measure each one's own")
        if self.pattern == "checkerboard" and (self.corners[0] + self.corners[1]) % 2 == 0:
            raise ValueError(
                f"a checkerboard of {self.corners[0]} x {self.corners[1]} corners looks the same upside down: "
                "use one odd and one even number of corners, or pattern charuco"
            )
        if (self.pattern == "charuco") != (self.charuco is not None):
            raise ValueError("pattern charuco and the key charuco go together: give both or neither")
        if self.charuco and self.charuco.marker_size_m >= self.square_size_m:
            raise ValueError("charuco.marker_size_m must be smaller than square_size_m")
        return self


class Trigger(Section):
    """The trigger board that drives the buzzers."""

    driver: Literal["simulated", "serial"]
    port: str = Field("auto", description="auto, a path such as /dev/ttyACM0, or USB ids as VID:PID or VID:PID:SERIAL")

    @field_validator("port")
    @classmethod
    def _port_is_known_form(cls, value: str) -> str:
        usb = re.fullmatch(r"[0-9A-Fa-f]{4}:[0-9A-Fa-f]{4}(:[^:\s]+)?", value)
        if value != "auto" and not usb and not value.startswith(("/", "COM")):
            raise ValueError(f"port {value!r} is not 'auto', a path, or USB ids such as 2341:0043:75830303934351618291")
        return value


class Medium(Section):
    """The air: its temperature, or the speed of sound itself, and how well it is known."""

    temperature_c: float | None = Field(None, ge=-40, le=60)
    temperature_std_c: float | None = Field(None, gt=0, le=20)
    speed_of_sound_m_s: float | None = Field(None, ge=250, le=450)
    speed_of_sound_std_m_s: float | None = Field(None, gt=0, le=50)

    @model_validator(mode="after")
    def _one_of_two(self) -> Medium:
        if (self.temperature_c is None) == (self.speed_of_sound_m_s is None):
            raise ValueError("give either temperature_c or speed_of_sound_m_s")
        return self

    def speed_m_s(self) -> float:
        """Return the speed of sound; from the temperature by c = 331.3 sqrt(1 + T / 273.15) of dry air."""
        if self.speed_of_sound_m_s is not None:
            return self.speed_of_sound_m_s
        assert self.temperature_c is not None
        return 331.3 * math.sqrt(1 + self.temperature_c / 273.15)

    def speed_std_m_s(self) -> float:
        """Return the standard deviation of the speed of sound.

        Where nothing states it: a thermometer is good to 1 degree, and a room without one is within 5 of what is usual.
        """
        if self.speed_of_sound_std_m_s is not None:
            return self.speed_of_sound_std_m_s
        usual_c = 5.0 if self.temperature_c is None else 1.0
        return (self.temperature_std_c or usual_c) * 0.606  # dc/dT near 20 degrees


class Capture(Section):
    """How a session is captured and what makes a pose or an emission good."""

    poses: int = Field(25, ge=1, le=10000, strict=True)
    still_px: float = Field(
        0.3, gt=0, le=10, description="how far a still board may move between frames, root mean square of its corners"
    )
    still_s: float = Field(0.5, ge=0, le=30, description="how long the board must be still before the first buzzer")
    frame_interval_s: float = Field(0.2, gt=0, le=60, description="time between stored frames of a pose")
    pose_timeout_s: float = Field(120.0, gt=0, le=36000, description="how long to wait for a still, found board")
    new_pose_px: float = Field(
        10.0, ge=0, le=1000, description="movement that makes a new pose, root mean square of the corners"
    )
    max_blur_px: float = Field(
        2.0, gt=0, le=50, description="a board with blurrier edges is not captured: standard deviation of the blur"
    )
    min_level_dbfs: float = Field(-60.0, ge=-120, le=0, description="an emission quieter than this is not accepted")
    clip_level: float = Field(0.99, gt=0, le=1, description="samples beyond this share of full scale are clipped")
    onset_tolerance_s: float = Field(0.03, gt=0, le=1, description="how far an onset may lie from where it is expected")
    device_wait_s: float = Field(30.0, ge=0, le=3600, description="how long to wait for a device that was lost")
    retries: int = Field(2, ge=0, le=20, description="how often a bad emission is fired again")


class StartBox(Section):
    """Where a random first guess of each microphone is drawn (methods ours-1 to ours-3)."""

    low_m: Position = (0.0, 0.0, 0.0)
    high_m: Position = (0.5, 0.5, 0.5)

    @model_validator(mode="after")
    def _low_is_below_high(self) -> StartBox:
        if any(low >= high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise ValueError("low_m must be below high_m on every axis")
        return self


class Calibration(Section):
    """Priors for calibration."""

    start_box_m: StartBox = StartBox()
    max_tdoa_s: float = Field(0.005, gt=0, le=0.1, description="no pair of microphones is further apart than this")


class RigDescription(Section):
    """A rig, whole."""

    format: Literal["acoustic-rig"] = "acoustic-rig"
    version: Literal[1] = 1
    name: str = Field(min_length=1, max_length=80)
    audio: Audio
    camera: Camera
    board: Board
    trigger: Trigger
    signal: Signal
    medium: Medium
    capture: Capture = Capture()
    calibration: Calibration = Calibration()
    simulation: Simulation = Simulation()

    @property
    def min_poses(self) -> int:
        """How many poses a session of this rig needs before it can be calibrated."""
        return MIN_POSES_FOR_INTRINSICS if self.camera.intrinsics == "from session" else MIN_POSES

    @model_validator(mode="after")
    def _signal_fits_sample_rate(self) -> RigDescription:
        high_hz = self.signal.waveform().band_hz()[1]
        if self.signal.kind != "mls" and high_hz >= 0.5 * self.audio.sample_rate_hz:
            raise ValueError(
                f"the signal reaches {high_hz:g} Hz, more than half of audio.sample_rate_hz: lower it or sample faster"
            )
        return self
