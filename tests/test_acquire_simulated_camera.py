"""The simulated camera: the board's corners are where optics say."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from simulated import go_to_pose, make_description, open_rig

from acquire.devices.choose import choose_devices
from acquire.devices.simulated.lens import pixel_rays
from acquire.errors import DeviceError
from rigs.board import board_corners_m, find_corners
from rigs.description import Intrinsics
from rigs.errors import DescriptionError


def projected_px(points_m, board_to_camera, camera_matrix, distortion):
    """Project as the textbook has it, written apart from the renderer."""
    k1, k2, p1, p2, k3 = distortion
    x, y, z = (points_m @ board_to_camera[:3, :3].T + board_to_camera[:3, 3]).T
    x, y = x / z, y / z
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    bent_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return (np.column_stack([bent_x, bent_y, np.ones_like(x)]) @ camera_matrix.T)[:, :2]


def seen_and_true_px(seed, poses, **sections):
    """Return the pictures, the corners found in them and the true ones, pose by pose."""
    rig, board = open_rig(seed, **sections), make_description(**sections).board
    for pose in poses:
        go_to_pose(rig, pose)
        image, truth = rig.camera.read().image, rig.truth
        true_px = projected_px(
            board_corners_m(board), truth.board_to_camera[pose], truth.camera_matrix, truth.distortion
        )
        yield image, find_corners(image, board), true_px


@pytest.mark.parametrize("seed", range(4))
def test_the_checkerboard_is_found_where_it_is(seed):
    errors_px, refined_px = [], []
    for image, found_px, true_px in seen_and_true_px(seed, range(5)):
        assert found_px is not None
        errors_px.append(found_px - true_px)
        start = true_px.astype(np.float32).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
        refined_px.append(cv2.cornerSubPix(image, start, (5, 5), (-1, -1), criteria).reshape(-1, 2) - true_px)
    assert np.sqrt(np.mean(np.square(errors_px))) < 0.1
    assert np.abs(np.mean(errors_px, axis=(0, 1))).max() < 0.02
    assert np.abs(np.mean(refined_px, axis=(0, 1))).max() < 0.02
    assert np.sqrt(np.mean(np.square(refined_px))) < 0.06


def test_the_charuco_board_is_found_where_it_is():
    # with markers of less than 2.5 pixels to a module, it hangs on the noise whether all of them are read
    board = {"pattern": "charuco", "corners": (8, 5), "square_size_m": 0.035, "charuco": {"marker_size_m": 0.026}}
    errors_px = []
    for _, found_px, true_px in seen_and_true_px(0, range(4), board=board):
        assert found_px is not None
        assert np.isfinite(found_px).all()
        errors_px.append(found_px - true_px)
    assert np.sqrt(np.mean(np.square(errors_px))) < 0.1
    assert np.abs(np.mean(errors_px, axis=(0, 1))).max() < 0.02


def test_a_charuco_board_with_too_few_markers_is_refused():
    charuco = {"marker_size_m": 0.015, "dictionary": "DICT_4X4_50"}
    board = {"pattern": "charuco", "corners": (16, 11), "charuco": charuco}
    with pytest.raises(DescriptionError, match="too few markers"):
        choose_devices(make_description(board=board))


def test_rays_and_projection_undo_each_other():
    intrinsics = Intrinsics(
        focal_px=(950.0, 945.0), principal_px=(645.0, 352.0), distortion=(-0.12, 0.05, 5e-4, -5e-4, 0.01)
    )
    x, y = pixel_rays((1280, 720), intrinsics)
    rows, columns = np.mgrid[0:720:37, 0:1280:41]
    rays = np.column_stack([x[rows, columns].ravel(), y[rows, columns].ravel(), np.ones(rows.size)]).astype(float)
    matrix = np.array([[950.0, 0, 645], [0, 945.0, 352], [0, 0, 1]])
    pixels = projected_px(rays, np.eye(4), matrix, intrinsics.distortion)
    assert np.abs(pixels - np.column_stack([columns.ravel(), rows.ravel()])).max() < 1e-3


def test_a_still_board_is_seen_with_fresh_noise_each_frame():
    rig = open_rig()
    first, second = rig.camera.read(), rig.camera.read()
    difference = first.image.astype(float) - second.image
    assert first.image.shape == (720, 1280)
    assert first.image.dtype == np.uint8
    assert difference.std() == pytest.approx(2.0 * np.sqrt(2), rel=0.1)
    assert abs(difference.mean()) < 0.05


def test_the_board_is_out_of_view_until_asked_for_and_then_comes():
    rig = open_rig(capture={"poses": 5})
    board = make_description().board
    here_px = find_corners(rig.camera.read().image, board)
    rig.operator.ask_for_pose(1)
    pictures = [rig.camera.read().image for _ in range(16)]
    moved = [np.abs(a.astype(float) - b).mean() for a, b in pairwise(pictures)]
    there_px = find_corners(pictures[-1], board)
    assert max(moved) > 1.5 * moved[-1]
    assert np.abs(there_px - here_px).mean() > 10
    rig.operator.ask_for_pose(1)
    rig.clock.sleep_s(0.7)
    assert np.abs(find_corners(rig.camera.read().image, board) - there_px).mean() < 0.1


def test_frames_come_at_the_frame_rate_in_virtual_time():
    rig = open_rig()
    frames = [rig.camera.read() for _ in range(5)]
    stamps_s = np.array([frame.host_time_s for frame in frames])
    assert np.allclose(np.diff(stamps_s), 0.1, atol=0.01)
    assert np.ptp(np.diff(stamps_s)) > 0
    assert abs(rig.clock.now_s() - stamps_s[-1]) < 0.01


def test_pictures_are_the_same_for_a_seed_and_differ_between_seeds():
    first, again, other = (open_rig(seed).camera.read().image for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).mean() > 0.5


def test_the_board_slides_once_in_the_middle_of_a_pose():
    fault = {"kind": "board_moves", "pose": 1}
    rig, board = open_rig(simulation={"faults": [fault]}), make_description().board
    waveform = make_description().signal.waveform()

    def movement_px():
        before = find_corners(rig.camera.read().image, board)
        for buzzer in (1, 2, 3, 4):
            rig.trigger.play(buzzer, waveform)
            rig.clock.sleep_s(0.5)
        return np.abs(find_corners(rig.camera.read().image, board) - before).mean()

    assert movement_px() < 0.1
    go_to_pose(rig, 1)
    assert movement_px() > 1.0
    go_to_pose(rig, 1)
    assert movement_px() < 0.1


def test_a_lost_or_closed_camera_says_so():
    rig = open_rig(simulation={"faults": [{"kind": "camera_lost", "pose": 1}]})
    rig.camera.read()
    rig.operator.ask_for_pose(1)
    with pytest.raises(DeviceError, match="camera"):
        rig.camera.read()
    other = open_rig()
    other.camera.close()
    other.camera.close()
    with pytest.raises(DeviceError, match="not open"):
        other.camera.read()
