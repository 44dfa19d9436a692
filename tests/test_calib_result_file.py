"""Results read back from their files: what is refused, alike by every command, and what is taken out of them."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib.cli import command as calibrate
from calib.errors import ResultFileError
from calib.result_document import FORMAT, VERSION
from calib.result_file import MAX_BYTES, read_result
from calib.verification.cli import command as verify
from rigs.command import run

N_MICS = 8
COMMANDS = {
    "--compare": lambda path: run("rig", calibrate, ["--compare", str(path), str(path)]),
    "--export": lambda path: run("rig", calibrate, [str(path), "--export", "all"]),
    "rig-verify": lambda path: run("rig", verify, [str(path.with_name("s2.h5")), "--calibration", str(path)]),
}


@pytest.fixture
def document() -> dict:
    """Return what the file of a calibration holds."""
    generator = np.random.default_rng(0)
    spread = 1e-4 * generator.standard_normal((3 * N_MICS, 3 * N_MICS))
    covariance = spread @ spread.T / N_MICS
    blocks = [covariance[start : start + 3, start : start + 3] for start in range(0, 3 * N_MICS, 3)]
    places_m = generator.uniform(-1, 1, (N_MICS, 3))
    return {
        "format": FORMAT,
        "version": VERSION,
        "method": "joint",
        "software": "acoustic-camera-rig 0",
        "speed_of_sound_m_s": 343.2,
        "speed_of_sound_std_m_s": 0.1,
        "microphones": [
            {"channel": N_MICS - row, "position_m": place.tolist(), "covariance_m2": block.tolist()}
            for row, (place, block) in enumerate(zip(places_m, blocks, strict=True))
        ],
        "camera": {"focal_px": [940, 941], "principal_px": [640, 360], "distortion": [0.1, 0, 0, 0, 0.01]},
        "recording": {
            "sample_rate_hz": 48000,
            "channels": list(range(1, N_MICS + 1)),
            "picture_size_px": [1280, 720],
        },
        "session": {"name": "s1", "sha256": "0" * 64},
        "array_covariance_m2": covariance.tolist(),
    }


def written(folder: Path, content: dict | str) -> Path:
    path = folder / "s1.calib.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content, sort_keys=False))
    return path


def test_what_the_file_says_is_what_is_read(document, tmp_path):
    read = read_result(written(tmp_path, document))
    covariance = np.array(document["array_covariance_m2"])
    assert (read.name, read.sessions, read.method) == ("s1.calib.yaml", {"0" * 64: "s1"}, "joint")
    assert read.channels == tuple(range(N_MICS, 0, -1))
    assert read.columns == tuple(range(N_MICS - 1, -1, -1))
    np.testing.assert_array_equal(read.array_covariance_m2, covariance)
    np.testing.assert_array_equal(read.covariance_m2, [one["covariance_m2"] for one in document["microphones"]])
    np.testing.assert_array_equal(read.std_m.ravel(), np.sqrt(np.diag(covariance)))
    assert (read.intrinsics.focal_px, read.intrinsics.distortion[4]) == ((940, 941), 0.01)
    some = read.only((2, 7))
    assert (some.names, some.columns) == (["microphone_2", "microphone_7"], (1, 6))
    np.testing.assert_array_equal(some.positions_m, read.positions_m[[6, 1]])
    np.testing.assert_array_equal(some.array_covariance_m2[:3, 3:], covariance[18:21, 3:6])


def test_several_sessions_are_all_named(document, tmp_path):
    document["sessions"] = [document.pop("session") | {"n_poses": 12}, {"name": "s2", "sha256": "1" * 64}]
    read = read_result(written(tmp_path, document))
    assert read.session_names == "s1 + s2"
    assert list(read.sessions) == ["0" * 64, "1" * 64]


def two_alike(document: dict) -> None:
    """Make a covariance with an eigenvalue below 0 whose blocks are as good as ever."""
    covariance = document["array_covariance_m2"]
    covariance[0][3] = covariance[3][0] = 2 * math.sqrt(covariance[0][0] * covariance[3][3])


SPOILT = {
    "no method": (lambda d: d.pop("method"), "method: missing"),
    "text for a speed": (lambda d: d.update(speed_of_sound_m_s="fast"), "speed_of_sound_m_s: 'fast' is not a number"),
    "NaN in the covariance": (lambda d: d["array_covariance_m2"][3].__setitem__(4, math.nan), "covariance_m2[3][4]"),
    "eigenvalue": (two_alike, "array_covariance_m2: not symmetric with positive"),
    "a variance of 0": (
        lambda d: d["microphones"][2].update(covariance_m2=np.zeros((3, 3)).tolist()),
        "microphones[2].covariance_m2: not symmetric",
    ),
    "contradiction": (
        lambda d: d["microphones"].insert(1, d["microphones"].pop(0)),
        "microphones[0].covariance_m2 and array_covariance_m2 contradict",
    ),
    "channel twice": (lambda d: d["microphones"][7].update(channel=8), "microphones[7].channel: 8 is listed twice"),
    "no distortion": (lambda d: d["camera"].pop("distortion"), "camera.distortion: missing"),
    "old": (lambda d: d.pop("recording"), "has no recording: an earlier version made it"),
    "no session": (lambda d: d.pop("session"), "session: missing"),
    "newer": (lambda d: d.update(version=VERSION + 1), "of version 2, this software reads 1"),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_a_spoilt_result_is_refused_with_place_and_remedy(document, tmp_path, kind):
    spoil, words = SPOILT[kind]
    spoil(document)
    path = written(tmp_path, document)
    with pytest.raises(ResultFileError) as refused:
        read_result(path)
    line = str(refused.value)
    assert line.startswith(f"{path}: ")
    assert words in line
    assert line.endswith("calibrate the session again")
    assert "\n" not in line


TEXTS = {
    "a key twice": ("format: a\nformat: b\n", "line 2, column 1: key 'format' is given twice: keep one"),
    "an alias": ("a: &x [1]\nb: *x\n", "line 2, column 4: aliases"),
    "nested without end": ("[" * 1_000_000, "not YAML: nested too deeply"),
    "far too long": ("#" * (MAX_BYTES + 1), "larger than 10 MB"),
    "another file": ("name: rig\n", "not a result of rig-calibrate: name a SESSION.calib.yaml"),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_every_command_refuses_the_same_in_the_same_words(tmp_path, capsys, kind):
    text, words = TEXTS[kind]
    path, said = written(tmp_path, text), []
    for refuse in COMMANDS.values():
        assert refuse(path) == 2
        said.append(capsys.readouterr().err)
    assert set(said) == {said[0]}
    assert said[0].startswith(f"rig: {path}")
    assert words in said[0]
    assert said[0].count("\n") == 1
