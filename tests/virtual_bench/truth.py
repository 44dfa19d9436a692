"""What is true at the bench, for evaluation only: kept in a file that no session and no calibration sees."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.devices.simulated.scene import Scene
from rigs.board import camera_matrix
from virtual_bench.ears import Emission
from virtual_bench.hands import Place

TRUTH_FILE = "truth.json"


@dataclass(frozen=True)
class BenchTruth:
    """What `write_truth` wrote, read again.

    Parameters
    ----------
    microphones_m : (n_mics, 3) array
        Camera frame, in the order of the rig's channels.
    emissions : list of Emission
    document : dict
        All of it: see `write_truth`.
    """

    microphones_m: NDArray[np.float64]
    emissions: list[Emission]
    document: dict[str, Any]


def write_truth(
    folder: Path, scene: Scene, places: Sequence[Place], emissions: Sequence[Emission], slips_s: Sequence[float]
) -> None:
    """Write the truth so far into a folder; whoever reads it meanwhile finds the file whole."""
    document = {
        "seed": scene.seed,
        "microphones_m": scene.microphones_m.tolist(),
        "buzzers_m": scene.buzzers_m.tolist(),
        "square_size_m": scene.board.square_size_m,
        "speed_of_sound_m_s": scene.speed_of_sound_m_s,
        "camera_matrix": camera_matrix(scene.intrinsics).tolist(),
        "distortion": list(scene.intrinsics.distortion),
        "places": [_place(place) for place in places],
        "emissions": [asdict(emission) for emission in emissions],
        "sound_slips_s": list(slips_s),
    }
    unfinished = folder / f"{TRUTH_FILE}.part"
    unfinished.write_text(json.dumps(document, indent=1) + "\n")
    unfinished.replace(folder / TRUTH_FILE)


def read_truth(folder: Path) -> BenchTruth:
    """Read what `write_truth` wrote."""
    document = json.loads((folder / TRUTH_FILE).read_text())
    emissions = [Emission(**emission) for emission in document["emissions"]]
    return BenchTruth(np.array(document["microphones_m"]), emissions, document)


def _place(place: Place) -> dict[str, Any]:
    return {
        "number": place.number,
        "board_to_camera": place.board_to_camera.matrix().tolist(),
        "reached_s": place.reached_s,
        "left_s": place.left_s,
    }
