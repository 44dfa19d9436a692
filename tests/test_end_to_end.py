"""From the command that captures to the file that says where the microphones are, as a user runs them."""

import hashlib
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from capturing import rig_text
from simulated import make_description

from calib.cli import command as calibrate_command
from rigs.command import run
from rigs.session.reader import Session

BIN = Path(sys.executable).parent
SIX_BUZZERS = [
    {"id": 1 + 3 * row + column, "position_m": (-0.045 + 0.145 * column, -0.045 + 0.215 * row, -0.005)}
    for row in range(2)
    for column in range(3)
]


def shell(*arguments: object, exit_code: int = 0, cwd: Path) -> str:
    """Run a console script as a user does and return what it printed on both streams."""
    name, *rest = (str(argument) for argument in arguments)
    done = subprocess.run([BIN / name, *rest], cwd=cwd, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == exit_code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def result_of(path: Path) -> dict:
    return yaml.safe_load(path.read_text())


def capture_short(folder: Path, name: str, **sections: dict) -> Path:
    """Capture 8 poses at 640 x 480 with a rig of the test's own."""
    changes = {
        "board": {"buzzers": SIX_BUZZERS, "buzzer_std_m": 0.0001, "square_size_std_m": 0.000005},
        "camera": {"size_px": (640, 480)},
        "signal": {"gap_s": 0.2},
        "capture": {"poses": 8},
    }
    description = make_description(**{key: changes.get(key, {}) | sections.get(key, {}) for key in changes | sections})
    (folder / "rig.yaml").write_text(rig_text(description))
    shell("rig-capture", "--session", name, "--seed", 5, cwd=folder)
    return folder / f"{name}.h5"


@pytest.fixture(scope="module")
def short_session(tmp_path_factory) -> Path:
    return capture_short(tmp_path_factory.mktemp("short"), "short")


@pytest.fixture
def session(short_session, tmp_path) -> Path:
    """Return a copy that a test may spoil."""
    return Path(shutil.copy(short_session, tmp_path / "s1.h5"))


@pytest.mark.parametrize("seed", range(10))
def test_demo_is_right_to_six_tenths_of_a_millimetre(tmp_path, seed):
    said = shell("rig-capture", "--session", "demo", "--rig", "simulated", "--seed", seed, cwd=tmp_path)
    assert "25 poses saved" in said
    shell("rig-calibrate", "demo.h5", cwd=tmp_path)
    result = result_of(tmp_path / "demo.calib.yaml")
    assert result["evaluation"]["rmse_m"] <= 0.0006
    assert result["camera"]["source"] == "session"
    assert result["sound"]["tdoa"] == "matched"
    assert result["sound"]["arrival_std_s"] < 1e-7
    assert result["warnings"] == []
    (tmp_path / "demo.h5").unlink()  # 230 MB


@pytest.mark.parametrize(
    ("method", "problem", "layout", "paper_rmse_m", "rmse_m"),
    [
        ("ours-1", 7, "B", 0.04701, 0.04874),
        ("ours-2", 28, "A", 0.02606, 0.02819),
        ("ours-3", 8, "B", 0.06146, 0.06696),
    ],
)
def test_published_measurements_give_the_papers_figures(
    aislab_folder, tmp_path, method, problem, layout, paper_rmse_m, rmse_m
):
    shell(
        "rig-session", "import", "aislab", aislab_folder.resolve(), "-o", "aislab.h5",
        "--problem", problem, "--layout", layout, cwd=tmp_path,
    )  # fmt: skip
    said = shell("rig-calibrate", "aislab.h5", "--method", method, cwd=tmp_path)
    evaluation = result_of(tmp_path / "aislab.calib.yaml")["evaluation"]
    assert evaluation["paper_rmse_m"] == pytest.approx(paper_rmse_m, abs=0.00005)
    assert evaluation["rmse_m"] == pytest.approx(rmse_m, abs=0.00005)
    assert f"{1e3 * evaluation['rmse_m']:.2f} mm in the camera frame" in said
    assert f"{1e3 * evaluation['paper_rmse_m']:.2f} mm (microphones 1 to 7" in said


def test_joint_method_takes_published_measurements(aislab_folder, tmp_path):
    shell("rig-session", "import", "aislab", aislab_folder.resolve(), "-o", "aislab.h5", cwd=tmp_path)
    shell("rig-calibrate", "aislab.h5", cwd=tmp_path)
    result = result_of(tmp_path / "aislab.calib.yaml")
    assert result["held_out"]["median_s"] < 11.5e-6
    assert result["held_out"]["robust_sigma_s"] < 17.2e-6  # the 24 kHz grid alone leaves 16.4 us
    assert result["held_out"]["spread_m"] < 0.005
    assert result["evaluation"]["distance_rmse_m"] < 0.013
    assert result["evaluation"]["rmse_aligned_m"] < 0.015
    assert result["camera"]["focal_px"] == pytest.approx([525, 525], abs=5)  # what is known of this kind of camera
    assert any("focal length came out at" in warning for warning in result["warnings"])
    assert any("the board is bent" in warning for warning in result["warnings"])
    assert result["evaluation"]["rotation_deg"] == pytest.approx(7, abs=1)


def test_acoular_reads_a_captured_session(short_session, monkeypatch):
    monkeypatch.chdir(short_session.parent)  # Acoular makes a cache folder where it stands
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Acoular's and its dependencies' own
        import acoular

    source = acoular.TimeSamples(file=str(short_session))
    with Session.open(short_session) as session:
        assert source.sample_freq == session.sample_rate_hz == 48000
        assert (source.num_samples, source.num_channels) == (session.n_samples, 8)
        np.testing.assert_array_equal(next(source.result(48000)), session.audio(0, 48000))


def test_charuco_session_calibrates(tmp_path):
    board = {
        "pattern": "charuco",
        "charuco": {"dictionary": "DICT_4X4_100", "marker_size_m": 0.019},
        "buzzers": SIX_BUZZERS,
    }
    path = capture_short(tmp_path, "charuco", board=board, camera={"size_px": (1280, 720)})
    shell("rig-calibrate", path, cwd=tmp_path)
    assert result_of(tmp_path / "charuco.calib.yaml")["evaluation"]["rmse_m"] < 0.003


def test_mls_session_calibrates(tmp_path):
    path = capture_short(tmp_path, "mls", signal={"kind": "mls", "gap_s": 0.3})
    shell("rig-calibrate", path, cwd=tmp_path)
    assert result_of(tmp_path / "mls.calib.yaml")["evaluation"]["rmse_m"] < 0.003


def test_known_reference_microphone_serves_ours_3_and_the_sync_output_is_no_microphone(tmp_path):
    audio = {"reference_microphone": {"channel": 9, "position_m": (0.05, 0.12, 0.02)}, "sync_channel": 10}
    path = capture_short(tmp_path, "nine", audio=audio, signal={"gap_s": 0.4})
    said = [
        run("rig-calibrate", calibrate_command, [str(path), "--method", "ours-3", "--seed", str(seed), "--overwrite"])
        for seed in range(4)
    ]
    assert 0 in said
    shell("rig-calibrate", path, "--method", "joint", "--overwrite", cwd=tmp_path)
    assert result_of(tmp_path / "nine.calib.yaml")["evaluation"]["rmse_m"] < 0.003


def test_a_dead_channel_is_named_and_can_be_left_out(tmp_path):
    path = capture_short(tmp_path, "dead", simulation={"faults": [{"kind": "dead_channel", "channel": 3}]})
    said = shell("rig-calibrate", path, exit_code=5, cwd=tmp_path)
    assert "channel 3" in said
    assert not (tmp_path / "dead.calib.yaml").exists()
    shell("rig-calibrate", path, "--exclude-channel", 3, cwd=tmp_path)
    assert len(result_of(tmp_path / "dead.calib.yaml")["microphones"]) == 7


def test_a_silent_buzzer_costs_only_its_emissions(tmp_path):
    path = capture_short(tmp_path, "silent", simulation={"faults": [{"kind": "silent_buzzer", "buzzer": 2}]})
    shell("rig-calibrate", path, cwd=tmp_path)
    result = result_of(tmp_path / "silent.calib.yaml")
    assert result["residual"]["n_used"] <= 8 * 5 * 28
    assert result["evaluation"]["rmse_m"] < 0.003


def test_lost_samples_do_no_harm(tmp_path):
    path = capture_short(tmp_path, "gap", simulation={"faults": [{"kind": "audio_overflow", "pose": 2}]})
    shell("rig-calibrate", path, cwd=tmp_path)
    assert result_of(tmp_path / "gap.calib.yaml")["evaluation"]["rmse_m"] < 0.003


def test_not_a_number_in_audio_is_named(session):
    with Session.open(session) as opened:
        first = int(opened.emissions["expected_sample"][0])
    with h5py.File(session, "r+") as file:
        file["time_data"][first : first + 2000, 4] = np.nan
    said = shell("rig-calibrate", session, cwd=session.parent)
    assert "not numbers" in said
    assert result_of(session.with_suffix(".calib.yaml"))["evaluation"]["rmse_m"] < 0.003


def test_audio_of_nothing_but_nan_is_refused(session):
    with h5py.File(session, "r+") as file:
        file["time_data"][:] = np.nan
    assert "heard by any microphone" in shell("rig-calibrate", session, exit_code=5, cwd=session.parent)


def test_pictures_without_a_board_are_refused(session):
    """The rig description of the session names another board than its pictures show."""
    with h5py.File(session, "r+") as file:
        text = file["rig/description"][:].tobytes().replace(b"- 9\n  - 6\n", b"- 8\n  - 5\n")
        assert b"- 8\n  - 5\n" in text
        file["rig/description"][:] = np.frombuffer(text, np.uint8)
        file["rig/description"].attrs["sha256"] = np.bytes_(hashlib.sha256(text).hexdigest())
    said = shell("rig-calibrate", session, exit_code=5, cwd=session.parent)
    assert "the board was found standing still in" in said


@pytest.mark.parametrize("script", ["rig-capture", "rig-calibrate", "rig-session"])
def test_scripts_explain_themselves(tmp_path, script):
    assert "Usage: " + script in shell(script, "--help", cwd=tmp_path)
    assert "Error" in shell(script, "--no-such-option", exit_code=2, cwd=tmp_path)


def test_a_full_disk_is_named_with_what_was_saved(tmp_path, short_session):
    """A limit on the file's size stands in for a full disk: the system refuses to write on either."""
    shutil.copy(short_session.parent / "rig.yaml", tmp_path)
    limit = short_session.stat().st_size // 2 // 1024
    done = subprocess.run(
        ["bash", "-c", f"ulimit -f {limit}; trap '' XFSZ; exec {BIN}/rig-capture --session full --seed 5"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 3
    assert "cannot be written (File too large)" in done.stderr
    assert "poses saved in full.h5" in done.stderr
    with Session.open(tmp_path / "full.h5") as session:
        assert (session.poses["accepted"] == 1).sum() >= 2


def test_a_reader_that_goes_away_does_not_end_the_capture(tmp_path, short_session):
    shutil.copy(short_session.parent / "rig.yaml", tmp_path)
    capture = f"{BIN}/rig-capture --session piped --poses 2"
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {capture} | head -1"], cwd=tmp_path, capture_output=True, text=True,
        timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with Session.open(tmp_path / "piped.h5") as session:
        assert session.complete
        assert (session.poses["accepted"] == 1).sum() == 2


def test_a_steady_tone_is_warned_of_and_refused(tmp_path):
    path = capture_short(tmp_path, "tone", signal={"kind": "tone"}, capture={"poses": 6})
    assert "steady tone" in shell("rig-calibrate", path, exit_code=5, cwd=tmp_path)


def test_clipping_is_still_known_at_calibration(tmp_path):
    path = capture_short(tmp_path, "loud", simulation={"faults": [{"kind": "loud_channel", "channel": 2}]})
    assert "channel 2 clipped in 100% of the emissions" in shell("rig-calibrate", path, cwd=tmp_path)


@pytest.mark.parametrize("session_name", [".", "..", "nowhere/s1"])
def test_impossible_session_names_are_refused(tmp_path, session_name):
    said = shell("rig-capture", "--session", session_name, exit_code=2, cwd=tmp_path)
    assert said.startswith("rig-capture: ")
    assert list(tmp_path.iterdir()) == []
