"""Exports, each read back by the tool that it is for, and what a damaged result makes of them."""

import csv
import json
import os
import re
import runpy
import shutil
import subprocess
import warnings
from pathlib import Path
from xml.etree import ElementTree

import libconf
import numpy as np
import pytest
import yaml
from conftest import write_measured_session
from scipy.io import loadmat

from calib import outputs
from calib.cli import command
from calib.export.formats import FORMATS
from rigs.command import run
from rigs.errors import TargetExistsError

ODD = "a--b <i>&amp;\"'s1"


def calibrate(*arguments: object) -> int:
    return run("rig-calibrate", command, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def exported(tmp_path_factory, simulated_description) -> Path:
    """Return the result of a session with an odd name, channel 3 left out, with all exports beside it."""
    session = write_measured_session(tmp_path_factory.mktemp("odd") / f"{ODD}.h5", simulated_description)
    assert calibrate(session, "--exclude-channel", 3, "--export", "all", "--no-report") == 0
    return session.with_suffix(".calib.yaml")


@pytest.fixture
def result(exported, tmp_path) -> Path:
    """Return a copy of the result, alone, that a test may spoil."""
    return Path(shutil.copy(exported, tmp_path / "s1.calib.yaml"))


def beside(result: Path, ending: str) -> Path:
    return result.with_name(result.name.removesuffix(".calib.yaml") + ending)


def positions(result: Path) -> np.ndarray:
    return np.array([one["position_m"] for one in yaml.safe_load(result.read_text())["microphones"]])


def covariances(result: Path) -> np.ndarray:
    return np.array([one["covariance_m2"] for one in yaml.safe_load(result.read_text())["microphones"]])


CHANNELS = [1, 2, 4, 5, 6, 7, 8]


def test_acoular_reads_its_geometry(exported, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # Acoular makes a cache folder where it stands
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Acoular's and its dependencies' own
        import acoular

    microphones = acoular.MicGeom(file=str(beside(exported, ".acoular.xml")))
    np.testing.assert_allclose(microphones.pos.T, positions(exported), atol=1e-12)


def test_pyroomacoustics_makes_an_array(exported):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = runpy.run_path(str(beside(exported, ".pyroomacoustics.py")))
    np.testing.assert_allclose(loaded["array"].R.T, positions(exported), atol=1e-12)
    assert loaded["array"].fs == 48000
    assert loaded["speed_of_sound_m_s"] == yaml.safe_load(exported.read_text())["speed_of_sound_m_s"]


def test_odas_has_places_covariances_channels_and_speed(exported):
    with beside(exported, ".odas.cfg").open() as stream:
        configuration = libconf.load(stream)
    general, stored = configuration["general"], yaml.safe_load(exported.read_text())
    assert list(configuration["mapping"]["map"]) == CHANNELS
    np.testing.assert_allclose([mic["mu"] for mic in general["mics"]], positions(exported), atol=1e-12)
    sigma2 = np.array([mic["sigma2"] for mic in general["mics"]]).reshape(-1, 3, 3)
    np.testing.assert_allclose(sigma2, covariances(exported), rtol=1e-5, atol=1e-15)
    assert general["samplerate"]["mu"] == 48000
    assert general["speedofsound"]["mu"] == pytest.approx(stored["speed_of_sound_m_s"], abs=1e-4)
    assert general["speedofsound"]["sigma2"] == pytest.approx(stored["speed_of_sound_std_m_s"] ** 2, rel=1e-3)


def test_ros2_launches_a_transform_for_each_microphone(exported):
    launch = ElementTree.parse(beside(exported, ".ros2.launch.xml")).getroot()
    arguments = [node.get("args").replace("$(var camera_frame)", "cam").split() for node in launch.iter("node")]
    found = [dict(zip(words[::2], words[1::2], strict=True)) for words in arguments]
    np.testing.assert_allclose(
        [[float(one[f"--{axis}"]) for axis in "xyz"] for one in found], positions(exported), atol=1e-12
    )
    assert [one["--child-frame-id"] for one in found] == [f"microphone_{channel}" for channel in CHANNELS]
    assert {one["--frame-id"] for one in found} == {"cam"}
    assert {(one["--qx"], one["--qy"], one["--qz"], one["--qw"]) for one in found} == {("0", "0", "0", "1")}


def test_urdf_is_a_robot(exported):
    path = beside(exported, ".urdf")
    said = subprocess.run(["check_urdf", str(path)], capture_output=True, text=True, check=True).stdout
    assert "Successfully Parsed XML" in said
    assert [f"microphone_{channel}" in said for channel in CHANNELS] == [True] * len(CHANNELS)
    joints = ElementTree.parse(path).getroot().iter("origin")
    np.testing.assert_allclose([[float(v) for v in one.get("xyz").split()] for one in joints], positions(exported))


def test_kalibr_has_the_camera(exported):
    camera = yaml.safe_load(beside(exported, ".kalibr.yaml").read_text())["cam0"]
    stored = yaml.safe_load(exported.read_text())["camera"]
    assert camera["intrinsics"] == [*stored["focal_px"], *stored["principal_px"]]
    assert (camera["distortion_model"], camera["distortion_coeffs"]) == ("radtan", stored["distortion"][:4])
    assert camera["resolution"] == [1280, 720]


def test_a_third_radial_term_is_not_lost(result):
    stored = yaml.safe_load(result.read_text())
    stored["camera"]["distortion"][4] = 0.25
    del stored["digest"]
    result.write_text(yaml.safe_dump(stored, sort_keys=False))
    assert calibrate(result, "--export", "kalibr") == 0
    camera = yaml.safe_load(beside(result, ".kalibr.yaml").read_text())["cam0"]
    assert (camera["distortion_model"], camera["distortion_coeffs"][4]) == ("plumb_bob", 0.25)


def test_matlab_has_a_struct(exported):
    array = loadmat(beside(exported, ".microphones.mat"), simplify_cells=True)["array"]
    np.testing.assert_array_equal(array["positions_m"], positions(exported))
    np.testing.assert_array_equal(np.moveaxis(array["covariance_m2"], 2, 0), covariances(exported))
    assert array["channels"].tolist() == CHANNELS
    assert array["columns_from_1"].tolist() == CHANNELS
    assert array["frame"].startswith("camera: OpenCV's")


def test_csv_has_a_row_for_each_microphone(exported):
    text = beside(exported, ".microphones.csv").read_text()
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    np.testing.assert_allclose([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in rows], positions(exported))
    assert [int(row["channel"]) for row in rows] == CHANNELS
    assert [int(row["column"]) for row in rows] == [channel - 1 for channel in CHANNELS]
    for row, covariance in zip(rows, covariances(exported), strict=True):
        assert float(row["cov_yz_m2"]) == pytest.approx(covariance[1, 2], rel=1e-4)
        assert float(row["std_x_m"]) == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-4)


def test_json_has_everything(exported):
    document = json.loads(beside(exported, ".microphones.json").read_text())
    np.testing.assert_array_equal([one["position_m"] for one in document["microphones"]], positions(exported))
    np.testing.assert_array_equal([one["covariance_m2"] for one in document["microphones"]], covariances(exported))
    assert document["session"]["name"] == ODD
    assert document["camera"]["picture_size_px"] == [1280, 720]


@pytest.mark.parametrize("ending", [ending for files in FORMATS.values() for ending in files if ending[-4:] != ".npy"])
def test_each_says_frame_unit_order_and_speed(exported, ending):
    content = beside(exported, ending).read_bytes()
    for words in (b"camera: OpenCV", b"x right, y down, z forward, metres", b"acoustic-camera-rig"):
        assert words in content
    if ending != ".microphones.json":  # says it in keys
        for words in (b"input channels 1, 2, 4, 5, 6, 7, 8", b"columns 0, 1, 3, 4, 5, 6, 7", b"Speed of sound: 3"):
            assert words in content


def test_a_stored_result_exports_the_same_without_solving(exported, result):
    assert calibrate(result, "--export", "all") == 0
    for files in FORMATS.values():
        for ending in files:
            if ending != ".microphones.mat":  # has the time in its header
                assert beside(result, ending).read_bytes() == beside(exported, ending).read_bytes()


def test_only_what_is_asked_for_is_written(result):
    assert calibrate(result, "--export", "csv, acoular") == 0
    assert {path.name for path in result.parent.iterdir()} == {
        "s1.calib.yaml", "s1.acoular.xml", "s1.microphones.csv"
    }  # fmt: skip


def refusal(capsys, result: Path, *arguments: object) -> str:
    """Run, see that it is refused in one line with code 2 and leaves nothing, and return the line."""
    before = {path: path.read_bytes() for path in result.parent.iterdir()}
    assert calibrate(result, *arguments) == 2
    error = capsys.readouterr().err.strip()
    assert "\n" not in error
    assert error.startswith("rig-calibrate: ")
    assert {path: path.read_bytes() for path in result.parent.iterdir()} == before
    return error


@pytest.mark.parametrize("names", ["acoulr", "", "csv,,json"])
def test_unknown_exports_are_named(result, capsys, names):
    error = refusal(capsys, result, "--export", names)
    assert "is not known: give all, or some of acoular,pyroomacoustics" in error


def test_a_result_alone_needs_an_export(result, capsys):
    assert "a result, not a session" in refusal(capsys, result)


@pytest.mark.parametrize(
    "arguments", [("--plots", "png"), ("--method", "ours-2"), ("--suggest-poses", 2), ("--hold", "speed")]
)
def test_what_needs_the_session_is_refused_with_a_result(result, capsys, arguments):
    error = refusal(capsys, result, "--export", "all", *arguments)
    assert f"{arguments[0]} does nothing with a result" in error


def test_a_comparison_takes_nothing_else(result, capsys):
    assert "--export does nothing with a result" in refusal(capsys, result, result, "--compare", "--export", "csv")


def edited(change):
    def edit(text: str) -> str:
        document = yaml.safe_load(text)
        change(document)
        return yaml.safe_dump(document, sort_keys=False)

    return edit


def set_in(key: str, value: object):
    return edited(lambda document: document["microphones"][1].__setitem__(key, value))


BROKEN = {
    "cut": (lambda text: text[: text.index("]")], "line"),
    "tab": (lambda text: text.replace("  channel", "\tchannel", 1), "line"),
    "not a result": (lambda _: "name: rig\n", "not a result"),
    "a list": (lambda _: "- 1\n", "not a result"),
    "empty": (lambda _: "", "not a result"),
    "binary": (lambda _: "\x00\x01", "not YAML"),
    "newer": (edited(lambda document: document.update(version=2)), "version"),
    "no covariance": (edited(lambda document: document["microphones"][1].pop("covariance_m2")), "covariance_m2"),
    "no recording": (edited(lambda document: document.pop("recording")), "recording"),
    "no microphones": (edited(lambda document: document.update(microphones=[])), "microphones"),
    "a word for a number": (set_in("position_m", [0.1, "left", 0.2]), "position_m"),
    "NaN": (set_in("position_m", [0.1, float("nan"), 0.2]), "position_m"),
    "two coordinates": (set_in("position_m", [0.1, 0.2]), "position_m"),
    "lopsided": (set_in("covariance_m2", [[1e-8, 1e-8, 0.0], [0.0, 1e-8, 0.0], [0.0, 0.0, 1e-8]]), "no covariance"),
    "negative": (set_in("covariance_m2", [[-1e-8, 0.0, 0.0], [0.0, 1e-8, 0.0], [0.0, 0.0, 1e-8]]), "no covariance"),
    "twice": (set_in("channel", 1), "listed twice"),
    "strange channel": (set_in("channel", 12), "none of recording.channels"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_hand_edited_results_are_refused(result, capsys, kind):
    spoil, words = BROKEN[kind]
    result.write_text(spoil(result.read_text()))
    error = refusal(capsys, result, "--export", "all")
    assert words in error
    assert "s1.calib.yaml" in error


def test_a_missing_result_is_named(tmp_path, capsys):
    assert "cannot be read" in refusal(capsys, tmp_path / "none.calib.yaml", "--export", "csv")


def test_what_is_there_is_kept_unless_it_is_ours(result, capsys):
    table = beside(result, ".microphones.csv")
    table.write_text("my,own,table\n")
    assert "already there" in refusal(capsys, result, "--export", "all")
    assert "not made by this software" in refusal(capsys, result, "--export", "all", "--overwrite")
    table.unlink()
    assert calibrate(result, "--export", "all") == 0
    assert calibrate(result, "--export", "all", "--overwrite") == 0


def test_a_folder_that_cannot_be_written_to_is_named(result, capsys):
    assert "/sys: cannot be written to" in refusal(capsys, result, "--export", "csv", "-o", "/sys/s1.calib.yaml")


def test_a_full_disk_leaves_nothing(result, capsys, monkeypatch):
    fdopen, opened = os.fdopen, []

    def filled(handle: int, *arguments: object):
        opened.append(handle)
        if len(opened) == 4:
            raise OSError(28, "No space left on device")
        return fdopen(handle, *arguments)

    monkeypatch.setattr("calib.outputs.os.fdopen", filled)
    assert "No space left" in refusal(capsys, result, "--export", "all")
    assert len(opened) == 4


def test_snippets_of_the_pages_work(exported, tmp_path, monkeypatch):
    """Every block of Python in docs/consumers runs where the exports of s1 are."""
    for files in FORMATS.values():
        for ending in files:
            shutil.copy(beside(exported, ending), tmp_path / f"s1{ending}")
    monkeypatch.chdir(tmp_path)
    pages = sorted((Path(__file__).parents[1] / "docs" / "consumers").glob("*.md"))
    assert {page.stem for page in pages} >= {"acoular", "pyroomacoustics", "odas", "ros2", "kalibr", "matlab", "tables"}
    for page in pages:
        blocks = page.read_text().split("```python\n")[1:]
        assert blocks, page.name
        for block in blocks:
            code = block.split("```")[0]
            if ".h5" not in code:  # test_calib_beamformer.py runs those that need a session
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    exec(compile(code, page.name, "exec"), {})


def test_commands_of_the_pages_write_the_files_that_they_name(result, tmp_path, monkeypatch):
    """Every `rig-calibrate` of docs/consumers makes what its comment says and the page's code opens."""
    monkeypatch.chdir(tmp_path)
    asked = set()
    for page in sorted((Path(__file__).parents[1] / "docs" / "consumers").glob("*.md")):
        text = page.read_text()
        for line in re.findall(r"^    rig-calibrate (.*)$", text, re.MULTILINE):
            command, _, comment = line.partition("#")
            names = command.split("--export")[1].split()[0]
            asked |= set(names.split(","))
            assert calibrate(result, "--export", names, "--overwrite") == 0
            for file in re.findall(r"s1\.[a-z0-9.]+[a-z]", comment):
                assert (tmp_path / file).exists(), (page.name, file)
        for file in set(re.findall(r"s1\.[a-z0-9.]+[a-z]", text)) - {"s1.h5"}:
            assert (tmp_path / file).exists(), (page.name, file)
    assert asked == set(FORMATS)


def test_a_name_that_a_racing_run_has_taken_leaves_nothing_of_ours(tmp_path, monkeypatch):
    mine, theirs = tmp_path / "a.csv", tmp_path / "b.csv"
    hidden = outputs._hidden

    def while_another_runs(path, content, stack):
        theirs.write_bytes(b"theirs")
        return hidden(path, content, stack)

    monkeypatch.setattr(outputs, "_hidden", while_another_runs)
    with pytest.raises(TargetExistsError, match=r"b\.csv: already there"):
        outputs.write_outputs({mine: b"ours", theirs: b"ours"}, overwrite=False)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"b.csv": b"theirs"}
