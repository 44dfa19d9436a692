"""Measurements that support no answer: one clear line, exit code 5, no result, and what to do instead."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from conftest import MICROPHONES_M, make_world, write_measured_session
from measured_rig import CHANNELS, make_rig

from calib.cli import command
from calib.errors import NotEnoughDataError
from calib.joint.session import answer_jointly
from calib.result_file import read_result
from calib.settings import Settings
from rigs.command import run
from rigs.description import Intrinsics
from rigs.geometry import Pose


def answered(rig, **settings):
    return answer_jointly(rig.description, rig.view(), rig.corners, rig.tdoas, CHANNELS, Settings(**settings))


def facing(depth_m: float, x_m: float = 0.0, y_m: float = 0.0) -> Pose:
    return Pose(np.eye(3), np.array([x_m - 0.1, y_m - 0.06, depth_m]))


SAME = [facing(0.6)] * 8
ONE_DIRECTION = [facing(0.6, x, y) for x in (-0.15, 0.0, 0.15) for y in (-0.1, 0.0, 0.1)]


def refused(capsys, path, *options: str) -> str:
    """Run, and return the one line that was said."""
    assert run("rig-calibrate", command, [str(path), *options]) == 5
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("rig-calibrate: ")
    assert not path.with_suffix(".calib.yaml").exists()
    return line


@pytest.mark.parametrize("poses", [SAME, ONE_DIRECTION], ids=["the same", "one direction"])
def test_poses_that_tell_too_little_are_refused(poses):
    with pytest.raises(NotEnoughDataError, match="tilted"):
        answered(make_rig(0, poses=poses))


def test_the_same_pose_again_and_again(tmp_path, simulated_description, capsys, monkeypatch):
    monkeypatch.setattr("conftest.board_poses", lambda n, _: SAME[:n])
    line = refused(capsys, write_measured_session(tmp_path / "s1.h5", simulated_description, n_poses=8))
    assert "focal length and depth cannot be told apart" in line
    assert "capture more poses" in line


def test_poses_may_stand_in_any_order(tmp_path, simulated_description):
    path = write_measured_session(tmp_path / "s1.h5", simulated_description, n_poses=8)
    ordered, other = (tmp_path / f"{name}.calib.yaml" for name in ("ordered", "other"))
    assert run("rig-calibrate", command, [str(path), "-o", str(ordered), "--no-report"]) == 0
    with h5py.File(path, "r+") as file:
        for table in ("poses", "emissions"):
            rows = file[table][:]
            rows["pose"] = np.array([5, 0, 3, 7, 1, 2, 6, 4])[rows["pose"]]
            file[table][:] = rows
    assert run("rig-calibrate", command, [str(path), "-o", str(other), "--no-report"]) == 0
    first, second = (read_result(result).positions_m for result in (ordered, other))
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_one_microphone_that_heard_nothing(tmp_path, simulated_description, capsys):
    world = make_world(n_poses=12, noise_s=1e-6)
    tdoa_s = world.problem.tdoa_s.copy()
    tdoa_s[:, (world.problem.pairs == 2).any(axis=1)] = np.nan
    path = write_measured_session(tmp_path / "s1.h5", simulated_description, tdoa_s=tdoa_s)
    assert "channel 3 heard no emission well enough" in refused(capsys, path)
    assert run("rig-calibrate", command, [str(path), "--exclude-channel", "3"]) == 0


def test_corners_that_are_not_numbers(tmp_path, simulated_description, capsys):
    corners_px = np.full((12, 54, 2), np.nan)
    path = write_measured_session(tmp_path / "s1.h5", simulated_description, corners_px=corners_px)
    assert "the board was found standing still in 0 of 12 poses" in refused(capsys, path)


def test_an_array_and_boards_in_planes_are_found_or_told_but_never_wrong():
    """A planar array is found; where all sources lie in one plane too, each microphone may be in front or behind."""
    rig = make_rig(0, microphones_m=MICROPHONES_M * (1, 1, 0))
    answer = answered(rig)
    error_m = (answer.microphones_m - rig.truth.microphones_m).ravel()
    assert error_m @ np.linalg.solve(answer.array_covariance_m2, error_m) < 60  # of 24


@pytest.mark.parametrize("hold", [("intrinsics",), ("intrinsics", "speed", "scale", "buzzers", "poses")])
def test_held_intrinsics_that_contradict_everything_else(hold):
    rig = make_rig(0)
    wrong = Intrinsics(focal_px=(1034.0, 1032.0), principal_px=(645.0, 356.0), distortion=(0.05, -0.08, 0.0, 0.0, 0.0))
    camera = rig.description.camera.model_copy(update={"intrinsics": wrong})
    spoilt = replace(rig, description=rig.description.model_copy(update={"camera": camera}))
    with pytest.raises(NotEnoughDataError, match="contradict"):
        answered(spoilt, hold=hold)


def test_intrinsics_that_are_right_may_be_held():
    rig = make_rig(0)
    right = Intrinsics(
        focal_px=(940.0, 938.0), principal_px=(645.0, 356.0), distortion=(0.05, -0.08, 0.0005, -0.0004, 0)
    )
    camera = rig.description.camera.model_copy(update={"intrinsics": right})
    answer = answered(
        replace(rig, description=rig.description.model_copy(update={"camera": camera})), hold=("intrinsics",)
    )
    assert np.sqrt(np.mean((answer.microphones_m - rig.truth.microphones_m) ** 2)) < 0.001


@pytest.mark.parametrize("hold", [(), ("speed", "scale", "buzzers")])
def test_a_speed_of_sound_that_contradicts_the_rest_is_let_go_and_named(hold):
    rig = make_rig(0)
    medium = rig.description.medium.model_copy(
        update={"temperature_c": None, "speed_of_sound_m_s": 360.0, "speed_of_sound_std_m_s": 0.1}
    )
    answer = answered(replace(rig, description=rig.description.model_copy(update={"medium": medium})), hold=hold)
    assert any("the speed of sound is 34" in warning for warning in answer.warnings)
    assert np.sqrt(np.mean((answer.microphones_m - rig.truth.microphones_m) ** 2)) < 0.001


def test_a_rig_description_that_is_wrong_everywhere_is_refused():
    rig = make_rig(0)
    buzzers = rig.description.board.buzzers
    turned = [
        buzzer.model_copy(update={"position_m": other.position_m})
        for buzzer, other in zip(buzzers, (*buzzers[1:], buzzers[0]), strict=True)
    ]
    board = rig.description.board.model_copy(update={"buzzers": tuple(turned)})
    with pytest.raises(NotEnoughDataError, match="contradict each other in"):
        answered(replace(rig, description=rig.description.model_copy(update={"board": board})))
