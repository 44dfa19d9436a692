"""The study description: everything that a study tries, as a validated value.

Read it from the bottom: `StudyDescription` names arrays, boards, pose sets and noises, and `runs` combine them. Lengths
are metres, times seconds; the unit is part of every key.
"""

from __future__ import annotations

import re
from itertools import combinations
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from rigs.description import Position
from rigs.errors import DescriptionError
from rigs.section import Section

MethodName = Literal["ours-1", "ours-2", "ours-3", "search", "legg-2013", "joint"]
WITH_KNOWN = ("ours-3", "search", "legg-2013")  # methods that need a microphone at a known place
MAX_REPETITIONS = 100_000_000
APART_M = 1e-3  # microphones closer than this cannot be told apart

Side = Annotated[float, Field(gt=0, le=20)]
Depth = Annotated[float, Field(gt=0.05, le=20)]


class CubeArray(Section):
    """Eight microphones at the corners of a cube."""

    kind: Literal["cube"]
    side_m: Side = 0.5
    centre_m: Position = (0.0, 0.0, 0.0)

    def places_m(self) -> list[Position]:
        """Return the corners in the paper's order."""
        corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)]
        x, y, z = self.centre_m
        half = self.side_m / 2
        return [(x + half * (2 * i - 1), y + half * (2 * j - 1), z + half * (2 * k - 1)) for i, j, k in corners]


class RingArray(Section):
    """Microphones evenly on a circle around the viewing direction; with a rise they wind like a spring."""

    kind: Literal["ring"]
    n_mics: int = Field(ge=2, le=64)
    radius_m: Side
    rise_m: float = Field(0.0, ge=0, le=20, description="from the first to the last microphone, along z")
    centre_m: Position = (0.0, 0.0, 0.0)

    def places_m(self) -> list[Position]:
        """Return the microphones."""
        turn = 2 * np.pi * np.arange(self.n_mics) / self.n_mics
        rise_m = self.rise_m * np.linspace(-0.5, 0.5, self.n_mics)
        ring_m = np.column_stack([self.radius_m * np.cos(turn), self.radius_m * np.sin(turn), rise_m])
        return [(float(x), float(y), float(z)) for x, y, z in ring_m + np.array(self.centre_m)]


class ListedArray(Section):
    """Microphones at given places in the camera frame."""

    kind: Literal["places"]
    microphones_m: tuple[Position, ...] = Field(min_length=2, max_length=64)

    def places_m(self) -> list[Position]:
        """Return the microphones."""
        return list(self.microphones_m)


class RulerArray(Section):
    """The paper's real array, as its authors measured it with a ruler."""

    kind: Literal["ruler"]

    def places_m(self) -> list[Position]:
        """Return the microphones in the camera frame, taken as parallel to the array's."""
        from rigs.session.aislab import ARRAY_ORIGIN_M, RULER_M  # noqa: PLC0415 (heavy)

        return [(float(x), float(y), float(z)) for x, y, z in RULER_M + ARRAY_ORIGIN_M]


Array = Annotated[CubeArray | RingArray | ListedArray | RulerArray, Field(discriminator="kind")]


class ListedBoard(Section):
    """Buzzers at given places in the board frame."""

    kind: Literal["places"]
    buzzers_m: tuple[Position, ...] = Field(min_length=1, max_length=255)

    def places_m(self) -> list[Position]:
        """Return the buzzers."""
        return list(self.buzzers_m)


class PublishedBoard(Section):
    """One of the two sets of buzzer places that the paper's authors use."""

    kind: Literal["published"]
    layout: Literal["A", "B"]

    def places_m(self) -> list[Position]:
        """Return the buzzers."""
        from rigs.session.aislab import BUZZERS_MM  # noqa: PLC0415 (heavy)

        return [(x / 1000, y / 1000, z / 1000) for x, y, z in BUZZERS_MM[self.layout]]


class RigBoard(Section):
    """The board of a rig description."""

    kind: Literal["rig"]
    rig: str = Field(min_length=1, description="a path, or a shipped rig such as bench8")

    @field_validator("rig")
    @classmethod
    def _rig_is_there(cls, rig: str) -> str:
        try:
            _rig_buzzers_m(rig)
        except DescriptionError as error:
            raise ValueError(str(error)) from error
        return rig

    def places_m(self) -> list[Position]:
        """Return the buzzers."""
        return _rig_buzzers_m(self.rig)


def _rig_buzzers_m(rig: str) -> list[Position]:
    from rigs.library import find_description  # noqa: PLC0415 (heavy)

    return [buzzer.position_m for buzzer in find_description(rig, "this study").description.board.buzzers]


Board = Annotated[ListedBoard | PublishedBoard | RigBoard, Field(discriminator="kind")]


class PublishedPoses(Section):
    """The 69 board poses of the paper's measurements."""

    kind: Literal["published"]


class DrawnPoses(Section):
    """Board poses drawn at random before the camera."""

    kind: Literal["drawn"]
    n_poses: int = Field(25, ge=1, le=10000)
    nearest_m: Depth = 0.4
    furthest_m: Depth = 1.0
    tilt_deg: float = Field(35.0, ge=0, le=80, description="largest tilt about each of the board's axes")
    width: float = Field(0.25, ge=0, le=2, description="largest offset to each side, over the distance")
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _near_before_far(self) -> DrawnPoses:
        if self.nearest_m > self.furthest_m:
            raise ValueError("nearest_m must not be more than furthest_m")
        return self


PoseSet = Annotated[PublishedPoses | DrawnPoses, Field(discriminator="kind")]


class SimulatedNoise(Section):
    """What all simulated noise shares."""

    adds_to: Literal["pairs", "arrivals"] = Field(
        "arrivals", description="pairs: each TDOA has noise of its own, as in the paper; arrivals: as physics has it"
    )
    scale_s: float = Field(ge=0, le=0.1, description="gaussian: standard deviation; uniform: from 0 to this")
    grid_s: float = Field(0.0, ge=0, le=0.01, description="arrivals or TDOAs are rounded to multiples of this")
    outliers: float = Field(0.0, ge=0, le=0.5, description="share of values that are off by up to 2 ms")
    buzzer_std_m: float = Field(0.0, ge=0, le=0.1, description="how far buzzers are from where the board has them")


class GaussianNoise(SimulatedNoise):
    """Gaussian noise."""

    law: Literal["gaussian"]


class UniformNoise(SimulatedNoise):
    """Noise between 0 and a scale: its mean is not 0."""

    law: Literal["uniform"]


class MeasuredNoise(Section):
    """No simulation: the TDOAs that the paper's authors measured."""

    law: Literal["measured"]


Noise = Annotated[GaussianNoise | UniformNoise | MeasuredNoise, Field(discriminator="law")]


class Start(Section):
    """First guesses of the methods that need one: each microphone in a box, all moved and jittered together."""

    low_m: Position = (0.0, 0.0, 0.0)
    high_m: Position = (0.5, 0.5, 0.5)
    offset_m: Position = (-0.25, -0.25, -0.25)
    jitter_m: float = Field(0.05, ge=0, le=10, description="of all microphones together, to each side per axis")
    drawn: Literal["once", "each repetition"] = "each repetition"

    @model_validator(mode="after")
    def _low_is_below_high(self) -> Start:
        if any(low >= high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise ValueError("low_m must be below high_m on every axis")
        return self


class KnownMicrophone(Section):
    """A microphone at a known place, for the methods that need one: in the camera frame, or on the board at pose 1."""

    position_m: Position | None = None
    on_board_m: Position | None = Field(None, description="place in the board frame at the first pose")

    @model_validator(mode="after")
    def _one_of_two(self) -> KnownMicrophone:
        if (self.position_m is None) == (self.on_board_m is None):
            raise ValueError("give either position_m or on_board_m")
        return self


class Run(Section):
    """What is combined: every array with every board, pose set, number of poses, noise and method."""

    arrays: tuple[str, ...] = Field(min_length=1)
    boards: tuple[str, ...] = Field(min_length=1)
    pose_sets: tuple[str, ...] = Field(min_length=1)
    noises: tuple[str, ...] = Field(min_length=1)
    methods: tuple[MethodName, ...] = Field(min_length=1)
    n_poses: tuple[Annotated[int, Field(ge=1, le=10000)], ...] = Field(
        (), description="random subsets of so many poses, drawn for each repetition; all poses where nothing is given"
    )
    starts: Literal["once", "each repetition"] | None = Field(None, description="of this run, if not as in start.drawn")
    repetitions: int | None = Field(None, ge=1, le=MAX_REPETITIONS, description="of this run, if not the study's")


class StudyDescription(Section):
    """A study, whole."""

    format: Literal["acoustic-study"] = "acoustic-study"
    version: Literal[1] = 1
    name: str = Field(description="letters a to z, digits, blanks, . _ -; names the folder")
    title: str = Field("", max_length=300)
    seed: int = Field(0, ge=0, le=2**63 - 1)
    repetitions: int = Field(100, ge=1, le=MAX_REPETITIONS, strict=True)
    speed_of_sound_m_s: float = Field(343.0, ge=250, le=450)
    start: Start = Start()
    known_microphone: KnownMicrophone | None = None
    search_judged_in: Literal["camera frame", "array frame"] = Field(
        "camera frame", description="array frame: as the paper's authors judge their search, its pose left aside"
    )
    arrays: dict[str, Array] = Field(min_length=1)
    boards: dict[str, Board] = Field(min_length=1)
    pose_sets: dict[str, PoseSet] = Field(min_length=1)
    noises: dict[str, Noise] = Field(min_length=1)
    runs: tuple[Run, ...] = Field(min_length=1)

    @field_validator("name")
    @classmethod
    def _name_can_name_a_folder(cls, name: str) -> str:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,79}", name):
            raise ValueError(
                f"{name[:100]!r} cannot name a folder everywhere: give up to 80 letters a to z, digits, blanks, "
                ". _ -, a letter or digit first; title takes any words"
            )
        return name

    @field_validator("arrays")
    @classmethod
    def _arrays_are_possible(cls, arrays: dict[str, Array]) -> dict[str, Array]:
        for name, array in arrays.items():
            for (i, first), (j, second) in combinations(enumerate(array.places_m(), start=1), 2):
                if np.linalg.norm(np.subtract(first, second)) < APART_M:
                    raise ValueError(f"array {name!r} is impossible: microphones {i} and {j} are at the same place")
        return arrays

    @model_validator(mode="after")
    def _runs_can_be_tried(self) -> StudyDescription:
        from calib.study.run_checks import check_runs  # noqa: PLC0415 (it is written in terms of this module)

        check_runs(self)
        return self
