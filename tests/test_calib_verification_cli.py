"""`rig-verify` as a user runs it, on sessions that begin with measured corners and TDOAs."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import MICROPHONES_M, make_world, write_measured_session

from calib.cli import command as calibrate_command
from calib.result_file import read_result
from calib.settings import Settings
from calib.verification.cli import command
from calib.verification.heldout import settings_of
from rigs.command import run

CHANNELS = list(range(1, 9))


@pytest.fixture(scope="module")
def calibration(tmp_path_factory, simulated_description) -> Path:
    folder = tmp_path_factory.mktemp("calibrated")
    session = write_measured_session(folder / "s1.h5", simulated_description, seed=1)
    assert run("rig-calibrate", calibrate_command, [str(session)]) == 0
    return folder / "s1.calib.yaml"


@pytest.fixture
def later(tmp_path, simulated_description) -> Path:
    return write_measured_session(tmp_path / "s2.h5", simulated_description, seed=2, n_poses=6)


@pytest.fixture
def document(calibration) -> dict:
    return yaml.safe_load(calibration.read_text())


def verify(*arguments: object) -> int:
    return run("rig-verify", command, [str(argument) for argument in arguments])


def refused(capsys, session: Path, calibration: Path, *more: object) -> tuple[int, str]:
    """Run, and return the exit code and the one line that was said; nothing may be left behind."""
    before = sorted(session.parent.iterdir())
    exit_code = verify(session, "--calibration", calibration, *more)
    error = capsys.readouterr().err.strip()
    assert error.startswith("rig-verify: ")
    assert "\n" not in error
    assert sorted(session.parent.iterdir()) == before
    return exit_code, error


def spoilt(tmp_path: Path, document: dict) -> Path:
    """Write a result edited by someone who means it, without its digest."""
    document = {key: value for key, value in document.items() if key != "digest"}
    path = tmp_path / "spoilt.calib.yaml"
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    return path


def test_a_later_session_passes(later, calibration, capsys):
    before = later.read_bytes(), calibration.read_bytes()
    assert verify(later, "--calibration", calibration, "--limit-moved-mm", 3) == 0
    assert (later.read_bytes(), calibration.read_bytes()) == before
    said = capsys.readouterr().out
    assert said.startswith("PASS")
    found = yaml.safe_load((later.with_suffix(".verify") / "verification.yaml").read_text())
    assert found["passed"]
    assert found["failures"] == []
    assert found["n_located"] == found["n_emissions"] == 36
    assert found["errors"]["picture_px"]["median"] < 1.5
    assert found["errors"]["space_m"]["rms"] < 2 * found["errors"]["space_m"]["expected_rms"]
    assert found["movement"]["told"]
    assert not found["calibration"]["made_again_without_these_poses"]
    errors_px = [math.dist(one["seen_px"], one["located_px"]) for one in found["emissions"]]
    assert np.median(errors_px) == pytest.approx(found["errors"]["picture_px"]["median"], abs=0.002)
    assert sorted(path.name for path in later.with_suffix(".verify").iterdir()) == ["verification.yaml"]


def test_a_microphone_that_moved_fails(tmp_path, simulated_description, calibration, capsys):
    world = make_world(n_poses=6, seed=2, noise_s=1e-6, buzzer_errors_m=simulated_description.board.buzzer_std_m)
    moved_m = MICROPHONES_M + np.array([0.0, 0.003, 0.001]) * (np.arange(8) == 3)[:, None]
    flights_s = np.linalg.norm(moved_m - world.problem.sources_m[:, None], axis=2) / world.truth.speed_of_sound_m_s
    first, second = world.problem.pairs.T
    noise_s = 1e-6 * np.random.default_rng(0).standard_normal(flights_s.shape)
    tdoa_s = (flights_s + noise_s)[:, second] - (flights_s + noise_s)[:, first]
    session = write_measured_session(tmp_path / "s2.h5", simulated_description, seed=2, n_poses=6, tdoa_s=tdoa_s)
    assert verify(session, "--calibration", calibration) == 5
    said = " ".join(capsys.readouterr().out.split())
    assert "FAIL array moved: microphone 4 by 3." in said
    found = yaml.safe_load((tmp_path / "s2.verify" / "verification.yaml").read_text())
    assert [one["what"] for one in found["movement"]["moved"] if one["alarm"]] == [4]
    shift_m = found["movement"]["moved"][0]["shift_m"]
    assert np.linalg.norm(np.array(shift_m) - [0.0, 0.003, 0.001]) < 0.001
    assert verify(session, "--calibration", calibration, "--limit-moved-mm", 10, "--overwrite") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "moved, but by less than 10 mm" in said
    assert "nothing has moved by more than 10 mm" in said


def test_a_limit_that_cannot_be_seen_is_not_told(later, calibration, capsys):
    assert verify(later, "--calibration", calibration, "--limit-moved-mm", 0.01) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("PASS sounds lie on their buzzers, within 0.25 degrees in the median ")
    assert "has moved by" not in said
    assert "? whether the array has moved since is not told: a microphone could have moved by up to" in said
    movement = yaml.safe_load((later.with_suffix(".verify") / "verification.yaml").read_text())["movement"]
    assert not movement["told"]
    assert "the limit is 0.01 mm" in movement["why_not"]
    assert movement["smallest_told_m"] == max(movement["smallest_told_by_channel_m"].values()) > 1e-5


@pytest.mark.parametrize(("limit_deg", "exit_code"), [(0.001, 5), (1.0, 0)])
def test_a_reader_who_has_gone_changes_no_verdict(later, calibration, limit_deg, exit_code):
    program = "import sys; from calib.verification.cli import main; sys.argv[0] = 'rig-verify'; main()"
    command = [sys.executable, "-c", program, later, "--calibration", calibration, "--limit-deg", limit_deg]
    reading, writing = os.pipe()
    os.close(reading)
    try:
        found = subprocess.run([str(word) for word in command], stdout=writing, stderr=subprocess.PIPE, check=False)
    finally:
        os.close(writing)
    assert found.returncode == exit_code
    assert found.stderr == b""


def test_the_calibrations_own_session_is_held_out(calibration, tmp_path, capsys):
    session = calibration.with_name("s1.h5")
    assert verify(session, "--calibration", calibration, "-o", tmp_path / "own") == 0
    assert "it was made again (joint) from the other poses" in " ".join(capsys.readouterr().out.split())
    found = yaml.safe_load((tmp_path / "own" / "verification.yaml").read_text())
    assert found["calibration"]["made_again_without_these_poses"]
    assert {one["pose"] for one in found["emissions"]} == {1, 4, 7, 10}


def test_the_calibrations_own_session_does_not_tell_of_movement(calibration, tmp_path, capsys):
    assert verify(calibration.with_name("s1.h5"), "--calibration", calibration, "-o", tmp_path / "own") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "has moved by" not in said
    assert "whether the array has moved since is not told: these poses were captured when it was calibrated" in said
    movement = yaml.safe_load((tmp_path / "own" / "verification.yaml").read_text())["movement"]
    assert not movement["told"]
    assert movement["smallest_told_m"] is None
    assert "capture a later session" in movement["why_not"]


def test_a_calibration_is_made_again_as_it_was_made(tmp_path, simulated_description, capsys):
    session = write_measured_session(tmp_path / "s1.h5", simulated_description, seed=1)
    chosen = ["--exact", "scale", "--hold", "buzzers", "--find-delays", "--seed", "3", "--exclude-channel", "5"]
    assert run("rig-calibrate", calibrate_command, [str(session), *chosen]) == 0
    expected = Settings(seed=3, excluded_channels=(5,), hold=("buzzers",), exact=("scale",), find_delays=True)
    assert settings_of(read_result(tmp_path / "s1.calib.yaml"), simulated_description) == expected
    assert verify(session, "--calibration", tmp_path / "s1.calib.yaml") == 0


def test_a_calibration_of_an_earlier_version_is_made_again_as_usual(document, tmp_path, simulated_description):
    del document["settings"]
    stored = read_result(spoilt(tmp_path, document))
    assert settings_of(stored, simulated_description) == Settings()


def test_one_of_several_calibrated_sessions_is_refused(calibration, document, tmp_path, capsys):
    document["sessions"] = [document.pop("session"), {"name": "s0", "sha256": "0" * 64}]
    exit_code, error = refused(
        capsys, calibration.with_name("s1.h5"), spoilt(tmp_path, document), "-o", tmp_path / "own"
    )
    assert exit_code == 2
    assert "was made from 2 sessions, s1 among them" in error


def test_an_edited_calibration_of_the_own_session_is_refused(calibration, document, tmp_path, capsys):
    document["microphones"][2]["position_m"][0] += 0.02
    exit_code, error = refused(
        capsys, calibration.with_name("s1.h5"), spoilt(tmp_path, document), "-o", tmp_path / "own"
    )
    assert exit_code == 2
    assert "has microphone 3 " in error


def test_an_edited_calibration_fails_on_a_later_session(later, document, tmp_path):
    document["microphones"][2]["position_m"][0] += 0.02
    assert verify(later, "--calibration", spoilt(tmp_path, document)) == 5


def test_an_edited_calibration_says_so(later, document, tmp_path, capsys):
    path = tmp_path / "x.calib.yaml"
    path.write_text(yaml.safe_dump(document))  # in another order, with other breaks: the same numbers
    read_result(path)
    document["microphones"][2]["position_m"][0] += 1e-4
    path.write_text(yaml.safe_dump(document))
    exit_code, error = refused(capsys, later, path)
    assert exit_code == 2
    assert "x.calib.yaml: edited by hand since it was written" in error
    assert "remove the line `digest`" in error


def test_sounds_beside_their_buzzers_fail(later, calibration, capsys):
    assert verify(later, "--calibration", calibration, "--limit-deg", 0.001) == 5
    assert "the limit is 0.001" in " ".join(capsys.readouterr().out.split())


def test_the_name_of_the_calibrated_session_is_told(tmp_path, simulated_description, calibration, capsys):
    session = write_measured_session(tmp_path / "s1.h5", simulated_description, seed=2, n_poses=6)
    assert verify(session, "--calibration", calibration) == 0
    assert "with another content" in " ".join(capsys.readouterr().out.split())


def channel_2_is_12(document: dict) -> None:
    document["microphones"][1]["channel"] = document["recording"]["channels"][1] = 12


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d: d.pop("array_covariance_m2"), "no array_covariance_m2"),
        (lambda d: d["array_covariance_m2"].pop(), "not the 24 x 24 numbers"),
        (lambda d: d["array_covariance_m2"][3].__setitem__(3, 1.0), "contradict each other"),
        (lambda d: d["microphones"][1].pop("covariance_m2"), "microphones[1].covariance_m2: missing"),
        (lambda d: d["microphones"][1].pop("position_m"), "microphones[1].position_m"),
        (lambda d: d["microphones"][1].update(position_m=[0, 0, "far"]), "microphones[1].position_m[2]"),
        (lambda d: d["microphones"][1].update(position_m=[0, 0, math.nan]), "microphones[1].position_m[2]"),
        (lambda d: d["microphones"][1].update(channel=1), "1 is listed twice"),
        (channel_2_is_12, "a microphone on channel 12, the session's rig"),
        (lambda d: d["camera"].update(principal_px=[64.0, 36.0]), "another camera's calibration"),
        (lambda d: d["camera"].update(focal_px=[-1.0, 940.0]), "focal lengths must be greater than 0"),
        (lambda d: d["array_covariance_m2"][3].__setitem__(9, 1.0), "so no covariance"),
        (lambda d: d.pop("session"), "session: missing"),
        (lambda d: d.update(format="something else"), "not a result of rig-calibrate"),
        (lambda d: d.update(version=2), "of version 2"),
        (lambda d: d.update(microphones="none"), "microphones: "),
        (lambda d: d.update(method="guess"), "method: "),
        (lambda d: d.clear(), "not a result of rig-calibrate"),
    ],
)  # fmt: skip
def test_a_spoilt_calibration_is_refused(later, document, tmp_path, capsys, spoil, words):
    spoil(document)
    exit_code, error = refused(capsys, later, spoilt(tmp_path, document))
    assert exit_code == 2
    assert words in error
    assert "spoilt.calib.yaml" in error


def test_fewer_channels_are_verified_or_refused(later, document, tmp_path, capsys):
    def keep(n: int) -> Path:
        part = document | {
            "microphones": document["microphones"][:n],
            "array_covariance_m2": [row[: 3 * n] for row in document["array_covariance_m2"][: 3 * n]],
        }
        return spoilt(tmp_path, part)

    exit_code, error = refused(capsys, later, keep(4))
    assert exit_code == 2
    assert "at least 5 are needed" in error
    assert verify(later, "--calibration", keep(6), "--limit-moved-mm", 9) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "none of the 6 microphones checked has moved" in said
    assert "channels 7, 8: not checked" in said


@pytest.mark.parametrize(
    "content", [b"", b"\x00\x01\xff", b"a: [1, 2", b"- 1\n- 2\n", None], ids=["empty", "bytes", "cut", "list", "none"]
)
def test_a_file_that_is_no_calibration_is_refused(later, tmp_path, capsys, content):
    path = tmp_path / "x.calib.yaml"
    if content is not None:
        path.write_bytes(content)
    exit_code, error = refused(capsys, later, path)
    assert exit_code == 2
    assert "x.calib.yaml" in error


def test_a_calibration_of_another_rig_fails(later, document, tmp_path):
    places_m = np.random.default_rng(0).uniform(-0.3, 0.3, (8, 3))
    for microphone, place_m in zip(document["microphones"], places_m, strict=True):
        microphone["position_m"] = [float(value) for value in place_m]
    assert verify(later, "--calibration", spoilt(tmp_path, document)) == 5


def test_a_missing_session_is_refused(tmp_path, calibration, capsys):
    assert refused(capsys, tmp_path / "s9.h5", calibration)[0] == 5


def test_what_is_there_is_not_replaced(later, calibration, capsys):
    folder = later.with_suffix(".verify")
    folder.mkdir()
    (folder / "diary.txt").write_text("mine")
    assert refused(capsys, later, calibration)[0] == 2
    exit_code, error = refused(capsys, later, calibration, "--overwrite")
    assert exit_code == 2
    assert "not a verification" in error
    assert (folder / "diary.txt").read_text() == "mine"


def test_an_earlier_verification_is_replaced(later, calibration, capsys):
    assert verify(later, "--calibration", calibration) == 0
    capsys.readouterr()
    assert "add --overwrite" in refused(capsys, later, calibration)[1]
    assert verify(later, "--calibration", calibration, "--overwrite") == 0


def test_a_folder_that_cannot_be_written_to_is_told(later, calibration, tmp_path, capsys, monkeypatch):
    closed = tmp_path / "closed"
    closed.mkdir()
    exit_code, error = refused(capsys, later, calibration, "-o", closed / "no" / "v")
    assert exit_code == 2
    assert "there is no folder" in error
    exit_code, error = refused(capsys, later, calibration, "-o", "/sys/v")  # nobody may write there, not even root
    assert exit_code == 2
    assert "/sys: cannot be written to" in error
    monkeypatch.setattr("tempfile.mkdtemp", _denied)  # as a network drive does, which says so only when asked to write
    exit_code, error = refused(capsys, later, calibration, "-o", closed / "v")
    assert exit_code == 2
    assert f"{closed / 'v'}: cannot be made (Permission denied): check the permissions" in error
    assert list(closed.iterdir()) == []


def _denied(*_: object, **__: object) -> str:
    raise PermissionError(13, "Permission denied", "closed")
