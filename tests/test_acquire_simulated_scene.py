"""The simulated scene: what is true, and where the board goes."""

import numpy as np
import pytest
from simulated import make_description

from acquire.devices.simulated.scene import draw_scene
from acquire.devices.simulated.texture import plate_corners_m
from rigs.description import Intrinsics
from rigs.errors import DescriptionError


@pytest.mark.parametrize("seed", range(3))
def test_microphones_are_not_coplanar_and_near_the_frame(seed):
    microphones_m = draw_scene(make_description(), seed).truth().microphones_m
    assert microphones_m.shape == (8, 3)
    spread_m = np.linalg.svd(microphones_m - microphones_m.mean(axis=0), compute_uv=False) / np.sqrt(8)
    assert spread_m.min() > 0.15
    off_frame_m = np.abs(np.abs(microphones_m) - 0.2)
    assert 0.0005 < off_frame_m.mean() < 0.01


@pytest.mark.parametrize("n_mics", [4, 6, 20])
def test_other_numbers_of_microphones_are_placed_too(n_mics):
    scene = draw_scene(make_description(audio={"channels": list(range(1, n_mics + 1))}), 0)
    centred_m = scene.microphones_m - scene.microphones_m.mean(axis=0)
    assert len(scene.microphones_m) == n_mics
    assert np.linalg.svd(centred_m, compute_uv=False).min() > 0.1
    first, second = np.triu_indices(n_mics, 1)
    assert np.linalg.norm(scene.microphones_m[first] - scene.microphones_m[second], axis=1).min() > 0.01


def test_microphones_are_out_of_the_cameras_view():
    scene = draw_scene(make_description(audio={"channels": list(range(1, 65))}), 0)
    ahead_m = scene.microphones_m[scene.microphones_m[:, 2] > 0]
    tangent = np.abs(ahead_m[:, :2]) / ahead_m[:, 2:]
    assert ((tangent > np.array([640, 360]) / scene.intrinsics.focal_px) | (tangent > 0.9)).any(axis=1).all()


def test_the_reference_microphone_is_heard_last_and_no_unknown():
    reference = {"channel": 9, "position_m": (0.0, 0.1, 0.0)}
    scene = draw_scene(make_description(audio={"reference_microphone": reference}), 0)
    error_m = np.linalg.norm(scene.microphones_m[8] - (0.0, 0.1, 0.0))
    assert 0 < error_m < 0.005  # it is only known to a millimetre
    assert len(scene.truth().microphones_m) == 8


def test_truth_differs_a_little_from_the_description():
    description = make_description(board={"buzzer_std_m": 0.0001})
    truth = draw_scene(description, 3).truth()
    described_m = np.array([buzzer.position_m for buzzer in description.board.buzzers])
    assert 1e-5 < np.abs(truth.buzzers_m - described_m).mean() < 3e-4
    assert 0 < abs(truth.speed_of_sound_m_s - description.medium.speed_m_s()) < 3
    assert truth.camera_matrix[0, 0] == pytest.approx(0.74 * 1280, rel=0.021)
    assert truth.distortion[0] == pytest.approx(-0.1, abs=0.011)
    assert truth.board_to_camera.shape == (5, 4, 4)


def test_given_intrinsics_are_taken():
    given = {"focal_px": (900.0, 901.0), "principal_px": (640.0, 350.0), "distortion": (-0.2, 0.1, 0.0, 0.0, 0.0)}
    scene = draw_scene(make_description(camera={"intrinsics": given}), 0)
    assert scene.intrinsics == Intrinsics(**given)
    assert scene.truth().camera_matrix[1, 2] == 350.0


def test_poses_are_in_view_near_and_far_and_tilted_every_way():
    description = make_description(capture={"poses": 40})
    scene = draw_scene(description, 0)
    truth = scene.truth()
    corners = plate_corners_m(description.board)
    places = np.einsum("pij,cj->pci", truth.board_to_camera[:, :3, :3], corners)
    places += truth.board_to_camera[:, None, :3, 3]
    pixels = places[..., :2] / places[..., 2:] @ truth.camera_matrix[:2, :2].T + truth.camera_matrix[:2, 2]
    assert pixels.min() > 0  # barrel distortion only draws them further in
    assert (pixels < [1320, 740]).all()
    depth_m = places[..., 2].mean(axis=1)
    assert depth_m.min() < 0.5
    assert depth_m.max() > 0.9
    tilt_x, tilt_y = truth.board_to_camera[:, 0, 2], truth.board_to_camera[:, 1, 2]
    for tilt in (tilt_x, tilt_y):
        assert tilt.min() < -np.sin(np.radians(20))
        assert tilt.max() > np.sin(np.radians(20))
    assert truth.board_to_camera[:, 2, 2].min() > np.cos(np.radians(35.1))
    assert pixels.mean(axis=1).std(axis=0).min() > 40


def test_a_large_board_is_held_further_away():
    description = make_description(board={"corners": (16, 9), "square_size_m": 0.1})
    places_m = draw_scene(description, 0).planned_pose(0).apply(plate_corners_m(description.board))
    assert places_m[:, 2].mean() > 1.2


def test_a_pose_does_not_depend_on_how_many_are_planned():
    few, many = (draw_scene(make_description(capture={"poses": n}), 0) for n in (3, 30))
    assert (few.truth().board_to_camera == many.truth().board_to_camera[:3]).all()
    assert (few.planned_pose(20).matrix() == many.truth().board_to_camera[20]).all()


@pytest.mark.parametrize(
    ("fault", "named"),
    [({"kind": "dead_channel", "channel": 99}, "channel 99"), ({"kind": "silent_buzzer", "buzzer": 77}, "buzzer 77")],
)
def test_a_fault_of_something_that_is_not_there_is_refused(fault, named):
    with pytest.raises(DescriptionError, match=named):
        draw_scene(make_description(simulation={"faults": [fault]}), 0)


@pytest.mark.parametrize("size_m", [(5.2, 4.3, 2.9), (2.0, 2.0, 2.0)])
def test_microphones_are_inside_the_room(size_m):
    for seed in range(5):
        scene = draw_scene(make_description(simulation={"room_size_m": size_m}), seed)
        places_m = scene.camera_to_room.apply(scene.microphones_m)
        assert places_m.min() > 0.05
        assert (places_m < np.array(size_m) - 0.05).all()
