"""The published measurements as a session; those that need the published files skip where the data folder is absent."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import savemat

from rigs.board import board_corners_m, estimate_pose, project
from rigs.errors import ImportFormatError, RigError, TargetExistsError
from rigs.session.aislab import ARRAY_ORIGIN_M, RULER_M, import_aislab
from rigs.session.aislab_command import import_group
from rigs.session.aislab_files import read_camera, read_poses, read_tdoas
from rigs.session.reader import Session

PUBLISHED = Path(__file__).resolve().parents[2] / "shared" / "data" / "aislab"
needs_data = pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the published files are not in ../shared/data/aislab")


@pytest.fixture
def imported(tmp_path):
    def session(**choices):
        target = tmp_path / "aislab.h5"
        import_aislab(PUBLISHED, target, overwrite=True, **choices)
        return Session.open(target)

    return session


@pytest.fixture
def copied(tmp_path):
    """A folder of the published files that a test may spoil."""
    folder = tmp_path / "published"
    folder.mkdir()
    for path in PUBLISHED.glob("*.mat"):
        shutil.copyfile(path, folder / path.name)
    return folder


@needs_data
def test_poses_from_the_rebuilt_corners_are_the_published_poses(imported):
    with imported() as session:
        board, intrinsics = session.description.board, session.description.camera.intrinsics
        buzzers_m = np.array([buzzer.position_m for buzzer in board.buzzers])
        found = [estimate_pose(corners, board, intrinsics).apply(buzzers_m) for corners in session.corners_px]
    published = [pose.apply(buzzers_m) for pose in read_poses(PUBLISHED)]
    assert np.abs(np.array(found) - published).max() < 2e-6  # metres; 0.001 mm was seen


@needs_data
def test_the_rebuilt_corners_lie_in_the_picture_with_the_published_spread(imported):
    with imported() as session:
        board, intrinsics = session.description.board, session.description.camera.intrinsics
        corners_px = session.corners_px
    expected_px = np.array([project(board_corners_m(board), pose, intrinsics) for pose in read_poses(PUBLISHED)])
    assert np.sqrt(np.mean(np.sum((corners_px - expected_px) ** 2, axis=2))) == pytest.approx(0.2309, abs=1e-4)
    assert corners_px[..., 1].min() > 49
    assert corners_px[..., 1].max() < 245


@needs_data
def test_matlab_counts_pixels_from_1_and_opencv_from_0():
    assert read_camera(PUBLISHED).intrinsics.principal_px == pytest.approx((324.64948, 270.34179), abs=1e-5)


@needs_data
@pytest.mark.parametrize(
    ("problem", "layout", "first_buzzer_m", "n_channels", "pairs"),
    [
        (28, "A", (0.195, -0.002, 0.0), 8, [(1, 2), (1, 3), (7, 8)]),
        (7, "B", (0.2, 0.0, 0.002), 8, [(1, 2), (1, 3), (1, 8)]),
        (8, "B", (0.2, 0.0, 0.002), 9, [(9, 1), (9, 2), (9, 8)]),
    ],
)
def test_the_session_holds_the_authors_choice_for_each_problem(
    imported, problem, layout, first_buzzer_m, n_channels, pairs
):
    with imported(problem=problem) as session:
        description = session.description
        assert description.name == f"aislab {problem} TDOAs, layout {layout}"
        assert description.board.buzzers[0].position_m == first_buzzer_m
        assert description.medium.speed_m_s() == 340
        assert len(description.audio.recorded_channels()) == n_channels
        assert session.tdoas.tdoa_s.shape == (414, problem)
        assert [tuple(pair) for pair in session.tdoas.pairs[[0, 1, -1]].tolist()] == pairs
        assert session.corners_px.shape == (69, 72, 2)
        assert session.n_samples == 0
        assert session.emissions["pose"].tolist() == np.repeat(np.arange(69), 6).tolist()
        assert session.emissions["buzzer"].tolist() == [1, 2, 3, 4, 5, 6] * 69
        assert session.poses["accepted"].sum() == 69
        assert session.truth.source == "ruler"
        np.testing.assert_allclose(session.truth.microphones_m, RULER_M + ARRAY_ORIGIN_M)


@needs_data
@pytest.mark.parametrize("problem", [28, 7, 8])
def test_signs_and_order_of_the_tdoas_fit_the_ruler(imported, problem):
    """The ruler's array is only roughly right, but a wrong sign, order or unit is off by milliseconds."""
    with imported(problem=problem) as session:
        description, tdoas = session.description, session.tdoas
        places_m = dict(zip(description.audio.channels, session.truth.microphones_m, strict=True))
    if description.audio.reference_microphone:
        places_m[9] = np.array(description.audio.reference_microphone.position_m)
    buzzers_m = np.array([buzzer.position_m for buzzer in description.board.buzzers])
    sources_m = np.array([pose.apply(buzzers_m) for pose in read_poses(PUBLISHED)]).reshape(-1, 3)
    arrival_s = {channel: np.linalg.norm(sources_m - place, axis=1) / 340 for channel, place in places_m.items()}
    expected_s = np.column_stack([arrival_s[j] - arrival_s[i] for i, j in tdoas.pairs.tolist()])
    assert np.median(np.abs(tdoas.tdoa_s - expected_s)) < 1.5e-4
    assert np.median(np.abs(expected_s)) > 3e-4


@needs_data
def test_the_layout_can_be_chosen(imported):
    with imported(problem=28, layout="B") as session:
        assert session.description.board.buzzers[1].position_m == (-0.04, 0.0, 0.002)


@needs_data
def test_the_ninth_microphone_stands_where_the_first_pose_puts_it(imported):
    with imported(problem=8) as session:
        position_m = session.description.audio.reference_microphone.position_m
    assert position_m == pytest.approx((0.253126, 0.016916, 0.327920), abs=1e-6)


@needs_data
def test_a_clone_of_the_authors_repository_will_do(tmp_path):
    for path in PUBLISHED.glob("*.mat"):
        (tmp_path / "clone" / "data" / path.stem).mkdir(parents=True)
        shutil.copyfile(path, tmp_path / "clone" / "data" / path.stem / path.name)
    with pytest.raises(ImportFormatError, match=r"new_cameraParams_69\.mat is missing"):
        import_aislab(tmp_path, tmp_path / "too_high.h5")
    import_aislab(tmp_path / "clone", tmp_path / "aislab.h5")
    assert (tmp_path / "aislab.h5").exists()


@needs_data
def test_nothing_is_written_over_unasked(tmp_path):
    target = tmp_path / "mine.h5"
    target.write_text("precious")
    with pytest.raises(TargetExistsError, match=r"mine\.h5: exists already.*--overwrite"):
        import_aislab(PUBLISHED, target)
    assert target.read_text() == "precious"


@needs_data
def test_a_failed_import_leaves_the_old_file(tmp_path, copied):
    target = tmp_path / "mine.h5"
    target.write_bytes(b"\x89HDF\r\n\x1a\nprecious")
    savemat(copied / "my_measurement_2_69_new.mat", {"measurement": np.zeros((414, 27))})
    with pytest.raises(ImportFormatError, match=r"measurement has the shape \(414, 27\), not \(414, 28\)"):
        import_aislab(copied, target, overwrite=True)
    assert target.read_bytes() == b"\x89HDF\r\n\x1a\nprecious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.h5", "published"]


@needs_data
@pytest.mark.parametrize("name", ["location.mat", "new_cameraParams_69.mat", "my_measurement_2_69_new.mat"])
@pytest.mark.parametrize("spoil", ["missing", "empty", "truncated", "foreign"])
def test_a_spoilt_file_is_named(tmp_path, copied, name, spoil):
    content = (copied / name).read_bytes()
    (copied / name).unlink()
    if spoil != "missing":
        spoilt = {"empty": b"", "truncated": content[: len(content) // 2], "foreign": b"not a MATLAB file\n" * 20}
        (copied / name).write_bytes(spoilt[spoil])
    with pytest.raises(ImportFormatError, match=name) as caught:
        import_aislab(copied, tmp_path / "aislab.h5")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "aislab.h5").exists()


@needs_data
def test_the_command_imports_and_says_what_comes_next(tmp_path):
    target = tmp_path / "aislab.h5"
    outcome = CliRunner().invoke(import_group, ["aislab", str(PUBLISHED), "-o", str(target), "--problem", "8"])
    assert outcome.exit_code == 0, outcome.output
    assert "69 poses, 414 emissions, 8 TDOAs each." in outcome.output
    assert f"next: rig-calibrate {target} --method ours-3" in outcome.output
    with Session.open(target) as session:
        assert session.description.name == "aislab 8 TDOAs, layout B"


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(ImportFormatError, match="nowhere: no such folder"):
        import_aislab(tmp_path / "nowhere", tmp_path / "aislab.h5")


def test_a_folder_without_the_files_is_named(tmp_path):
    with pytest.raises(ImportFormatError, match=r"new_cameraParams_69\.mat is missing") as caught:
        import_aislab(tmp_path, tmp_path / "aislab.h5")
    assert caught.value.exit_code == 5


def test_a_target_in_no_folder_is_refused(tmp_path):
    with pytest.raises(RigError, match="make it first"):
        import_aislab(tmp_path, tmp_path / "nowhere" / "aislab.h5")


def test_without_mat_io_the_extra_is_named(tmp_path, monkeypatch):
    (tmp_path / "new_cameraParams_69.mat").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "matio", None)  # what an import sees where it is not installed
    with pytest.raises(ImportFormatError, match=r"pip install 'acoustic-camera-rig\[aislab\]'"):
        read_camera(tmp_path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"measurement": np.zeros((413, 7))}, "measurement has the shape"),
        ({"measurement": "text"}, "measurement is missing or not an array of numbers"),
        ({"other": np.zeros((414, 7))}, "measurement is missing or not an array of numbers"),
        ({"measurement": np.full((414, 7), np.inf)}, "measurement holds infinite numbers"),
    ],
)
def test_tdoas_of_another_form_are_refused(tmp_path, content, said):
    savemat(tmp_path / "my_measurement_3_69_new.mat", content)
    with pytest.raises(ImportFormatError, match=said):
        read_tdoas(tmp_path, 7)


@pytest.mark.parametrize(
    ("location", "said"),
    [
        (np.zeros((1, 69)), "location should be a"),
        (np.zeros((1, 68), dtype=[("R", object), ("t", object)]), "location should be a"),
        (np.full((1, 69), 0, dtype=[("R", object), ("t", object)]), "R has the shape"),
    ],
)
def test_poses_of_another_form_are_refused(tmp_path, location, said):
    savemat(tmp_path / "location.mat", {"location": location})
    with pytest.raises(ImportFormatError, match=said):
        read_poses(tmp_path)


@needs_data
def test_overwriting_never_touches_what_is_no_session(tmp_path, copied):
    before = (copied / "location.mat").read_bytes()
    with pytest.raises(TargetExistsError, match="not a session"):
        import_aislab(copied, copied / "location.mat", overwrite=True)
    assert (copied / "location.mat").read_bytes() == before
