"""Whether two results differ: false alarms, power, and what is said to have moved."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import MICROPHONES_M, write_measured_session

from calib.cli import command
from calib.comparison import FALSE_ALARM, compare
from calib.comparison_screen import verdict
from calib.errors import MethodError
from calib.result import SOFTWARE, Recording
from calib.result_file import StoredCalibration, read_result
from calib.settings import Settings
from rigs.command import run
from rigs.description import Intrinsics
from rigs.geometry import Pose, rotation_matrix

CHANNELS = tuple(range(1, 9))
INTRINSICS = Intrinsics(focal_px=(940, 940), principal_px=(640, 360))
RECORDING = Recording(48000.0, CHANNELS, (1280, 720))


def drawn_covariance(generator: np.random.Generator, own_m: float = 0.0003, common_m: float = 0.001) -> np.ndarray:
    """Own errors of each microphone, and a larger one that all share, as a strained focal length makes it."""
    spread = generator.standard_normal((24, 24)) / np.sqrt(24)
    common = np.tile(generator.standard_normal(3), 8)[:, None] / np.sqrt(3)
    return own_m**2 * (spread @ spread.T + 0.2 * np.eye(24)) + common_m**2 * common @ common.T


def measured(generator: np.random.Generator, places_m: np.ndarray, name: str) -> StoredCalibration:
    covariance_m2 = drawn_covariance(generator)
    errors_m = generator.multivariate_normal(np.zeros(24), covariance_m2).reshape(8, 3)
    places_m = places_m + errors_m
    return StoredCalibration(
        name, {name: name}, Settings(), SOFTWARE, CHANNELS, places_m, covariance_m2, 340.0, 1.0, INTRINSICS, RECORDING
    )


def compared(seed: int, places_m: np.ndarray = MICROPHONES_M):
    generator = np.random.default_rng(seed)
    return compare(measured(generator, MICROPHONES_M, "a"), measured(generator, places_m, "b"))


def test_false_alarms_are_as_rare_as_said():
    found = [compared(seed) for seed in range(300)]
    assert np.mean([each.differ for each in found]) <= FALSE_ALARM + 3 * np.sqrt(FALSE_ALARM / 300)
    for fits in ([each.unmoved for each in found], [each.rigid for each in found if not each.differ]):
        assert 0.42 < np.mean([fit.chi_square.chance for fit in fits]) < 0.58


def test_an_array_that_was_turned_keeps_its_covariance():
    """Depth is known worst in both results; that of the first turns with the array."""
    turned_m = MICROPHONES_M @ rotation_matrix(np.array([1.2, 0.0, 0.0])).T
    covariance_m2 = np.kron(np.eye(8), np.diag([1e-4, 1e-4, 1e-3]) ** 2)
    chances = []
    for seed in range(60):
        generator = np.random.default_rng(seed)
        errors_m = generator.multivariate_normal(np.zeros(24), covariance_m2, 2).reshape(2, 8, 3)
        first, second = (
            replace(measured(generator, MICROPHONES_M, name), positions_m=places, array_covariance_m2=covariance_m2)
            for name, places in zip("ab", errors_m + np.array([MICROPHONES_M, turned_m]), strict=True)
        )
        chances.append(compare(first, second).rigid.chi_square.chance)
    assert 0.35 < np.mean(chances) < 0.65


def test_a_microphone_that_moved_is_named():
    places_m = MICROPHONES_M + 0.0031 * np.outer(np.arange(8) == 3, (0.6, 0.0, 0.8))
    found = [compared(seed, places_m) for seed in range(40)]
    assert np.mean([each.best.moved == (3,) and each.best.motion is None for each in found]) > 0.95
    shifts_m = [each.best.own_shift_m(3) for each in found]
    np.testing.assert_allclose(np.mean(shifts_m, axis=0), places_m[3] - MICROPHONES_M[3], atol=0.0002)
    length_mm = 1e3 * np.linalg.norm(shifts_m[0])
    assert verdict(found[0]) == f"the results differ: the microphone of channel 4 moved by {length_mm:.1f} mm"


def test_an_array_that_moved_as_a_whole_is_told_from_one_that_changed():
    motion = Pose.from_rotation_vector(np.radians([0.2, -0.2, 0.1]), np.array([0.0, 0.0021, 0.003]))
    found = [compared(seed, motion.apply(MICROPHONES_M)) for seed in range(40)]
    assert np.mean([each.best.motion is not None and not each.best.moved for each in found]) > 0.95
    assert np.mean([each.best.angle_deg for each in found]) == pytest.approx(0.3, abs=0.05)
    assert "the array as a whole moved against the camera by 3." in verdict(found[0])


def test_both_at_once_are_told_apart():
    """A camera put back on its tripod, by ten degrees elsewhere, and one microphone knocked."""
    motion = Pose.from_rotation_vector(np.radians([10.0, 0.0, 0.0]), np.array([0.0, 0.05, 0.0]))
    places_m = motion.apply(MICROPHONES_M) + 0.004 * np.outer(np.arange(8) == 6, (0, 1, 0))
    found = [compared(seed, places_m) for seed in range(20)]
    assert np.mean([each.best.motion is not None and each.best.moved == (6,) for each in found]) > 0.9


def test_a_shift_below_the_uncertainty_is_not_seen():
    places_m = MICROPHONES_M + 0.0001 * np.outer(np.arange(8) == 3, (1, 0, 0))
    assert np.mean([compared(seed, places_m).differ for seed in range(40)]) < 0.1


def test_an_array_that_changed_everywhere_differs():
    places_m = MICROPHONES_M + 0.004 * np.random.default_rng(0).standard_normal((8, 3))
    assert all(compared(seed, places_m).differ for seed in range(10))


def run_compare(*paths) -> int:
    return run("rig-calibrate", command, ["--compare", *map(str, paths)])


@pytest.fixture(scope="module")
def made(tmp_path_factory, simulated_description):
    folder = tmp_path_factory.mktemp("two")
    for seed in (0, 10):
        path = write_measured_session(folder / f"s{seed}.h5", simulated_description, seed=seed, n_poses=16)
        assert run("rig-calibrate", command, [str(path)]) == 0
    return folder


@pytest.fixture
def results(made, tmp_path):
    """Two sessions of one array, and copies of their results that a test may spoil."""
    shutil.copy(made / "s0.h5", tmp_path)
    return tuple(Path(shutil.copy(made / f"s{seed}.calib.yaml", tmp_path)) for seed in (0, 10))


def test_two_sessions_of_one_array_agree(results, capsys):
    assert run_compare(*results) == 0
    assert "the results agree within their uncertainties" in capsys.readouterr().out
    document = yaml.safe_load(results[1].read_text())
    document["microphones"][4]["position_m"][1] += 0.02
    del document["digest"]
    results[1].write_text(yaml.safe_dump(document, sort_keys=False))
    assert run_compare(*results) == 5
    assert "the microphone of channel 5 moved by 2" in capsys.readouterr().out
    assert run_compare(results[0], results[0]) == 0
    assert "both rest on the same session" in " ".join(capsys.readouterr().out.split())


def test_channels_that_both_have_are_compared(results):
    first, second = (read_result(path) for path in results)
    assert compare(first, second.only((8, 3, 5, 1))).first.channels == (1, 3, 5, 8)
    assert run_compare(*results, results[0]) == 2


@pytest.mark.parametrize("damage", ["missing", "a session", "text", "old", "cut", "nan"])
def test_what_is_no_result_is_refused(results, tmp_path, capsys, damage):
    path, document = tmp_path / "bad.calib.yaml", yaml.safe_load(results[0].read_text())
    if damage == "old":
        del document["array_covariance_m2"]
    if damage == "nan":
        document["microphones"][0]["position_m"][0] = float("nan")
    if damage == "cut":
        document["microphones"].pop()
    if damage in ("old", "nan", "cut"):
        path.write_text(yaml.safe_dump(document, sort_keys=False))
    elif damage == "text":
        path.write_text("- not a\n  result: [")
    elif damage == "a session":
        path = tmp_path / "s0.h5"
    assert run_compare(results[0], path) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"rig-calibrate: {path}")
    assert len(error.splitlines()) == 1


def test_too_few_common_channels(results, capsys):
    first, second = (read_result(path) for path in results)
    with pytest.raises(Exception, match="3 channels in common"):
        compare(first, replace(second, channels=(1, 2, 3, 21, 22, 23, 24, 25)))


def test_covariances_that_leave_no_scatter_are_refused():
    one = replace(measured(np.random.default_rng(0), MICROPHONES_M, "a"), array_covariance_m2=np.full((24, 24), 1e-8))
    with pytest.raises(MethodError, match="array_covariance_m2 of both together has no inverse"):
        compare(one, one)
