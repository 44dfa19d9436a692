"""`rig-calibrate` as a user meets it: results, exit codes, and one clear line for bad input."""

import hashlib
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from conftest import MICROPHONES_M, board_poses, make_world, write_measured_session

from calib.cli import command
from rigs.board import board_corners_m, project
from rigs.command import run
from rigs.description import Intrinsics

PAIRS = list(combinations(range(8), 2))


@pytest.fixture
def session(tmp_path, simulated_description) -> Path:
    return write_measured_session(tmp_path / "s1.h5", simulated_description)


def calibrate(*arguments: object) -> int:
    return run("rig-calibrate", command, [str(argument) for argument in arguments])


def refused(capsys, *arguments: object) -> tuple[int, str]:
    """Run, and return the exit code and the one line that was said."""
    exit_code = calibrate(*arguments)
    error = capsys.readouterr().err.strip()
    assert "\n" not in error
    assert error.startswith("rig-calibrate: ")
    return exit_code, error


def test_result_file_says_all_that_was_promised(session, capsys):
    before = session.read_bytes()
    assert calibrate(session) == 0
    assert session.read_bytes() == before
    result = yaml.safe_load(session.with_suffix(".calib.yaml").read_text())
    assert result["format"] == "acoustic-rig-calibration"
    assert result["version"] == 1
    assert result["method"] == "joint"
    assert result["frame"].startswith("camera")
    assert [mic["channel"] for mic in result["microphones"]] == list(range(1, 9))
    positions_m = np.array([mic["position_m"] for mic in result["microphones"]])
    assert np.abs(positions_m - MICROPHONES_M).max() < 0.003
    covariance_m2 = np.array([mic["covariance_m2"] for mic in result["microphones"]])
    std_m = np.array([mic["std_m"] for mic in result["microphones"]])
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance_m2, axis1=1, axis2=2)), std_m, atol=1e-6)
    errors = (positions_m - MICROPHONES_M) / std_m
    assert np.sqrt(np.mean(errors**2)) < 2
    assert result["residual"]["robust_sigma_s"] == pytest.approx(1.4e-6, rel=0.3)
    assert result["residual"]["n_used"] + result["residual"]["n_rejected"] == 12 * 6 * 28
    assert result["warnings"] == []
    assert result["evaluation"]["rmse_m"] < 0.002
    assert set(result["evaluation"]) >= {"rmse_aligned_m", "distance_rmse_m", "paper_rmse_m"}
    assert result["session"] == {"name": "s1", "sha256": hashlib.sha256(before).hexdigest()}
    shown = capsys.readouterr().out
    assert f"{1e3 * positions_m[0, 0]:+.1f}" in shown
    assert "s1.calib.yaml" in shown


@pytest.mark.parametrize("method", ["ours-1", "ours-2"])
def test_the_papers_methods_agree_with_joint(session, tmp_path, method):
    exit_codes = [calibrate(session, "--method", method, "--seed", seed, "--overwrite") for seed in range(6)]
    assert 0 in exit_codes  # Gauss-Newton from a random start does not always settle; the code says which did
    target = tmp_path / "good.yaml"
    assert calibrate(session, "--method", method, "--seed", exit_codes.index(0), "-o", target) == 0
    assert yaml.safe_load(target.read_text())["evaluation"]["rmse_m"] < 0.02


def test_same_session_same_answer(session, tmp_path):
    for name in ("a.yaml", "b.yaml"):
        assert calibrate(session, "-o", tmp_path / name) == 0
    assert (tmp_path / "a.yaml").read_bytes() == (tmp_path / "b.yaml").read_bytes()


def test_existing_result_is_kept(session, capsys):
    target = session.with_suffix(".calib.yaml")
    target.write_text("format: acoustic-rig-calibration\n# precious")
    assert refused(capsys, session)[0] == 2
    assert "precious" in target.read_text()
    assert calibrate(session, "--overwrite") == 0
    assert "precious" not in target.read_text()


def test_overwrite_replaces_nothing_but_an_earlier_result(session, tmp_path, capsys):
    before = session.read_bytes()
    (tmp_path / "notes.txt").write_text("precious")
    for target in (session, tmp_path / "notes.txt", tmp_path):
        assert refused(capsys, session, "--overwrite", "-o", target)[0] == 2
    assert session.read_bytes() == before
    assert (tmp_path / "notes.txt").read_text() == "precious"


def test_target_in_no_folder_is_refused(session, capsys):
    exit_code, error = refused(capsys, session, "-o", session.parent / "nowhere" / "a.yaml")
    assert exit_code == 2
    assert "no folder" in error


def test_excluded_channel_is_left_out(session):
    assert calibrate(session, "--exclude-channel", 3) == 0
    result = yaml.safe_load(session.with_suffix(".calib.yaml").read_text())
    assert [mic["channel"] for mic in result["microphones"]] == [1, 2, 4, 5, 6, 7, 8]
    assert result["evaluation"]["rmse_m"] < 0.003


def test_reference_is_for_ours_1_only(session, capsys):
    assert refused(capsys, session, "--reference", 3)[0] == 2


def test_reference_of_ours_1_can_be_chosen(session, capsys):
    assert refused(capsys, session, "--method", "ours-1", "--reference", 12) == (
        2,
        "rig-calibrate: channel 12 is not a microphone of this rig: it has 1, 2, 3, 4, 5, 6, 7, 8",
    )


def test_ours_3_needs_a_known_microphone(session, capsys):
    exit_code, error = refused(capsys, session, "--method", "ours-3")
    assert exit_code == 2
    assert "audio.reference_microphone" in error


def test_ours_2_needs_all_pairs(tmp_path, simulated_description, capsys):
    star = [(0, other) for other in range(1, 8)]
    path = write_measured_session(tmp_path / "star.h5", simulated_description, pairs=star)
    exit_code, error = refused(capsys, path, "--method", "ours-2")
    assert exit_code == 2
    assert "needs 28 pairs" in error


@pytest.mark.parametrize(
    ("content", "reason"),
    [(None, "missing"), (b"", "empty"), (b"not HDF5 at all" * 100, "foreign"), ("truncated", "truncated")],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_bad_files_are_refused(tmp_path, session, capsys, content, reason):
    bad = tmp_path / "bad.h5"
    if content == "truncated":
        bad.write_bytes(session.read_bytes()[: session.stat().st_size // 2])
    elif content is not None:
        bad.write_bytes(content)
    exit_code, error = refused(capsys, bad)
    assert exit_code == 5
    assert "bad.h5" in error
    assert not list(tmp_path.glob("bad.calib.yaml"))


def test_a_session_goes_by_its_name(session, monkeypatch):
    monkeypatch.chdir(session.parent)
    assert calibrate("s1") == 0
    assert Path("s1.calib.yaml").is_file()


def test_a_folder_that_takes_no_files_is_told(session, capsys):
    exit_code, error = refused(capsys, session, "-o", "/proc/a.yaml")
    assert exit_code == 2
    assert error.startswith("rig-calibrate: /proc: cannot be written to")


def test_the_screen_says_what_was_left_out(tmp_path, simulated_description, capsys):
    points_m = board_corners_m(simulated_description.board)
    intrinsics = Intrinsics(focal_px=(940.0, 940.0), principal_px=(640.0, 360.0))
    corners_px = np.array([project(points_m, pose, intrinsics) for pose in board_poses(12, 0)])
    corners_px[3] = np.nan
    path = write_measured_session(tmp_path / "s.h5", simulated_description, corners_px=corners_px)
    assert calibrate(path, "--hold", "speed") == 0
    said = capsys.readouterr().out
    assert "joint, speed held" in said
    assert "held, known to +-" in said
    assert "11 poses, corners" in said


def test_a_folder_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert refused(capsys, ".") == (5, "rig-calibrate: .: not a file: name a session file, such as s1.h5")


def test_a_damaged_file_is_refused_with_a_remedy(session, capsys):
    session.write_bytes(session.read_bytes()[:-2000])
    exit_code, error = refused(capsys, session)
    assert exit_code == 5
    assert error.endswith("`rig-session recover FILE -o NEW.h5` copies what is good")


def test_foreign_hdf5_is_refused(tmp_path, capsys):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = [1, 2, 3]
    assert refused(capsys, tmp_path / "other.h5")[0] == 5


@pytest.mark.parametrize("accepted", [0, 1])
def test_too_few_poses(tmp_path, simulated_description, capsys, accepted):
    path = write_measured_session(tmp_path / "few.h5", simulated_description, accepted=accepted)
    exit_code, error = refused(capsys, path)
    assert exit_code == 5
    assert f"{accepted} accepted {'pose' if accepted == 1 else 'poses'}, at least" in error
    assert "capture a session with more" in error


def test_no_board_found(tmp_path, simulated_description, capsys):
    unseen = np.full((12, 54, 2), np.nan)
    path = write_measured_session(tmp_path / "dark.h5", simulated_description, corners_px=unseen)
    exit_code, error = refused(capsys, path)
    assert exit_code == 5
    assert "board" in error


def test_dead_channel_is_named(tmp_path, simulated_description, capsys):
    tdoa_s = make_world(n_poses=12, noise_s=1e-6).problem.tdoa_s.copy()
    tdoa_s[:, [4 in pair for pair in PAIRS]] = np.nan
    path = write_measured_session(tmp_path / "dead.h5", simulated_description, tdoa_s=tdoa_s)
    exit_code, error = refused(capsys, path)
    assert exit_code == 5
    assert "channel 5" in error
    assert "--exclude-channel 5" in error
    assert calibrate(path, "--exclude-channel", 5) == 0


def test_some_missing_tdoas_do_no_harm(tmp_path, simulated_description):
    tdoa_s = make_world(n_poses=12, noise_s=1e-6).problem.tdoa_s.copy()
    tdoa_s[np.random.default_rng(0).random(tdoa_s.shape) < 0.2] = np.nan
    path = write_measured_session(tmp_path / "holes.h5", simulated_description, tdoa_s=tdoa_s)
    assert calibrate(path) == 0
    assert yaml.safe_load(path.with_suffix(".calib.yaml").read_text())["evaluation"]["rmse_m"] < 0.002


def test_all_tdoas_missing(tmp_path, simulated_description, capsys):
    tdoa_s = np.full((72, 28), np.nan)
    path = write_measured_session(tmp_path / "nan.h5", simulated_description, tdoa_s=tdoa_s)
    assert refused(capsys, path)[0] == 5


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from click.testing import CliRunner; from calib.cli import command; "
        "assert CliRunner().invoke(command, ['--help']).exit_code == 0; "
        "heavy = {'numpy', 'cv2', 'scipy', 'h5py', 'pydantic', 'rich'} & set(sys.modules); "
        "sys.exit(str(heavy) if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
