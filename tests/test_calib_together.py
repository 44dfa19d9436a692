"""Several sessions of one rig, solved together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import BUZZERS_M, board_poses, write_measured_session
from measured_rig import CHANNELS, Rig, make_rig
from test_calib_sync import LATENCIES_S, with_sync

from calib.camera import look
from calib.cli import command
from calib.errors import MethodError, NotEnoughDataError
from calib.joint.arrivals import ArrivalTable
from calib.joint.assemble import assemble
from calib.joint.corners import CornerTable
from calib.joint.problem import Weights
from calib.joint.robust import solve_robustly
from calib.joint.session import answer_jointly
from calib.joint.uncertainty import shared_covariance
from calib.settings import Settings
from calib.together import Measured, check_joinable, check_one_rig, put_together
from calib.unmoved import check_unmoved
from rigs.board import board_corners_m
from rigs.command import run

SPEEDS_M_S = (343.4, 346.1)


def at_another_time(rig: Rig, seed: int, speed_m_s: float, n_poses: int) -> Rig:
    """Return the same rig on another day: other poses, other air, other noise."""
    generator = np.random.default_rng([seed, 7])
    poses = board_poses(n_poses, seed + 1000)
    shared = rig.truth.shared.copy()
    shared[rig.truth.blocks.speed] = speed_m_s
    truth = replace(
        rig.truth,
        shared=shared,
        rotations=np.array([pose.rotation for pose in poses]),
        translations_m=np.array([pose.translation_m for pose in poses]),
    )
    board_m = board_corners_m(rig.description.board)
    corners_px = -CornerTable(board_m, np.zeros((n_poses, len(board_m), 2)), 1.0).residuals_px(truth)
    corners_px += rig.corner_std_px * generator.standard_normal(corners_px.shape)
    pose, buzzer = np.repeat(np.arange(n_poses), len(BUZZERS_M)), np.tile(np.arange(len(BUZZERS_M)), n_poses)
    std_s = rig.std_s[: len(pose)]
    arrival_s = ArrivalTable(pose, buzzer, np.zeros_like(std_s), std_s).flights(truth).times_s
    arrival_s = arrival_s + std_s * generator.standard_normal(std_s.shape) + np.arange(len(pose))[:, None]
    medium = rig.description.medium.model_copy(
        update={"speed_of_sound_m_s": speed_m_s, "speed_of_sound_std_m_s": 0.6, "temperature_c": None}
    )
    description = rig.description.model_copy(update={"medium": medium})
    return Rig(description, truth, corners_px, arrival_s, std_s, rig.corner_std_px)


def measured(rig: Rig, name: str) -> Measured:
    return Measured(name, f"hash of {name}", rig.description, rig.corners, rig.tdoas)


def two_days(seed: int, n_poses: int = 8) -> list[Rig]:
    rig = make_rig(seed)
    return [at_another_time(rig, 2 * seed + day, speed, n_poses) for day, speed in enumerate(SPEEDS_M_S)]


def answered_together(days: list[Rig], **settings):
    parts = [measured(day, f"s{number}") for number, day in enumerate(days, start=1)]
    corners, tdoas = put_together(parts)
    description = days[0].description
    view = look(description.camera, description.board, corners)
    media = tuple(part.description.medium for part in parts)
    return answer_jointly(description, view, corners, tdoas, CHANNELS, Settings(**settings), media=media)


def alone(rig: Rig):
    return answer_jointly(rig.description, rig.view(), rig.corners, rig.tdoas, CHANNELS, Settings())


def test_two_sessions_are_better_than_each_and_their_covariance_holds():
    squares, errors_alone, errors_together = [], [], []
    for seed in range(6):
        days = two_days(seed)
        together = answered_together(days)
        error_m = (together.microphones_m - days[0].truth.microphones_m).ravel()
        squares.append(error_m @ np.linalg.solve(together.array_covariance_m2, error_m))
        errors_together.append(np.mean(error_m**2))
        singles = [alone(day) for day in days]
        assert all(np.trace(together.array_covariance_m2) < np.trace(one.array_covariance_m2) for one in singles)
        errors_alone.append(np.mean([(one.microphones_m - days[0].truth.microphones_m) ** 2 for one in singles]))
        for found, std, true in zip(together.speeds_m_s, together.speed_stds_m_s, SPEEDS_M_S, strict=True):
            assert abs(found - true) < 4 * std
    assert np.mean(errors_together) < 0.8 * np.mean(errors_alone)
    assert 0.65 < np.mean(squares) / 24 < 1.45  # 1 is exact; 6 pairs of sessions leave a spread of 0.12


def test_the_equations_of_several_sessions_match_numeric_derivatives():
    days = two_days(0, n_poses=4)
    corners, tdoas = put_together([measured(day, f"s{number}") for number, day in enumerate(days)])
    description = days[0].description
    problem, start = assemble(
        description, look(description.camera, description.board, corners), corners, tdoas, CHANNELS,
        media=tuple(day.description.medium for day in days), find_delays=True,
    )  # fmt: skip
    at = start.placed(days[0].truth.microphones_m)
    delays_s = 1e-5 * np.random.default_rng(0).standard_normal(at.shared[at.blocks.delays].shape)
    shared = at.shared.copy()
    shared[at.blocks.delays] = delays_s
    at = replace(at, shared=shared)
    weights = problem.stated_weights()
    weights = Weights(weights.arrivals, 0 * weights.corners)
    gradient = problem.normal_equations(at, weights).shared_gradient
    residuals_s = problem.arrivals.residuals_s(at, weights.arrivals)
    cost = problem.arrivals.normal_equations(at, weights.arrivals).cost
    assert cost == pytest.approx(0.5 * np.sum(weights.arrivals * residuals_s**2))
    for place, step in [*((place, 1e-9) for place in range(24, 40)), (40, 1e-4), (41, 1e-4), (3, 1e-7), (43, 1e-7)]:
        costs = []
        for sign in (-1, 1):
            moved = at.shared.copy()
            moved[place] += sign * step
            costs.append(problem.normal_equations(replace(at, shared=moved), weights).cost)
        numeric = -(costs[1] - costs[0]) / (2 * step)
        assert numeric == pytest.approx(gradient[place], rel=1e-4, abs=1e-6 * np.abs(gradient).max() * 1e-3)
    shared_covariance(problem, at, problem.stated_weights())


def test_each_session_has_latencies_of_its_own():
    """What a filter makes of a buzzer's sound is learnt in each session anew, and so is how late it is."""
    days = two_days(0, n_poses=6)
    parts = [
        replace(measured(day, name), tdoas=with_sync(day, day.tdoas)) for day, name in zip(days, "ab", strict=True)
    ]
    later = replace(parts[1].tdoas.sound, onset_s=parts[1].tdoas.sound.onset_s - 1e-3)
    parts[1] = replace(parts[1], tdoas=replace(parts[1].tdoas, sound=later))
    corners, tdoas = put_together(parts)
    description = days[0].description
    problem, start = assemble(
        description, look(description.camera, description.board, corners), corners, tdoas, CHANNELS,
        media=tuple(part.description.medium for part in parts),
    )  # fmt: skip
    found = solve_robustly(problem, start.placed(days[0].truth.microphones_m)).at
    expected_s = np.concatenate([LATENCIES_S, LATENCIES_S + 1e-3])
    np.testing.assert_allclose(found.shared[found.blocks.latencies], expected_s, atol=2e-5)


def test_one_speed_for_both_days_would_be_wrong():
    """What is held apart matters: the air of the second day is 4 degrees warmer."""
    days = two_days(1, n_poses=12)
    together = answered_together(days)
    assert together.speeds_m_s[1] - together.speeds_m_s[0] == pytest.approx(2.7, abs=0.5)


def test_a_late_channel_of_one_session_is_named():
    days = two_days(2, n_poses=12)
    late = replace(days[1], arrival_s=days[1].arrival_s + 2e-4 * (np.arange(8) == 4))
    warnings = answered_together([days[0], late]).warnings
    assert any(warning.startswith("channel 5 of session 2 is 0.2") for warning in warnings)


def test_an_array_that_moved_in_between_is_refused():
    days = two_days(0, n_poses=10)
    check_unmoved([measured(day, name) for day, name in zip(days, "ab", strict=True)], CHANNELS, Settings())
    moved = days[1].truth.placed(days[1].truth.microphones_m + 0.02 * np.outer(np.arange(8) == 4, (0, 1, 0)))
    pose, buzzer = np.repeat(np.arange(10), 6), np.tile(np.arange(6), 10)
    table = ArrivalTable(pose, buzzer, np.zeros_like(days[1].std_s), days[1].std_s)
    longer_s = table.flights(moved).times_s - table.flights(days[1].truth).times_s
    knocked = replace(days[1], arrival_s=days[1].arrival_s + longer_s)
    with pytest.raises(NotEnoughDataError, match="the microphone of channel 5 moved by 2"):
        check_unmoved([measured(days[0], "a"), measured(knocked, "b")], CHANNELS, Settings())
    with pytest.raises(NotEnoughDataError, match="the microphones moved against the camera"):
        check_unmoved([measured(days[0], "a"), measured(knocked, "b")], (3, 5, 8), Settings())
    check_unmoved([measured(days[0], "a"), measured(knocked, "b")], (1, 3, 8), Settings())


@pytest.mark.parametrize(
    ("part", "changes"),
    [
        ("audio.channels", {"audio": {"channels": (1, 2, 3, 4, 5, 6, 7, 9)}}),
        ("camera.size_px", {"camera": {"size_px": (640, 480)}}),
        ("board", {"board": {"square_size_m": 0.03}}),
    ],
)
def test_sessions_of_two_rigs_are_refused(part, changes):
    rig = make_rig(0, n_poses=6)
    ((section, keys),) = changes.items()
    other = rig.description.model_copy(update={section: getattr(rig.description, section).model_copy(update=keys)})
    with pytest.raises(MethodError, match=f"not of one rig: {part} differs"):
        check_one_rig([measured(rig, "a"), measured(replace(rig, description=other), "b")])
    with pytest.raises(MethodError, match="the same session"):
        check_joinable([measured(rig, "a"), measured(rig, "a")])


def test_poses_keep_their_names():
    days = two_days(0, n_poses=4)
    corners, tdoas = put_together([measured(day, name) for day, name in zip(days, ("s1", "s2"), strict=True)])
    assert len(set(corners.pose)) == 8
    assert [tdoas.pose_names[int(pose)] for pose in corners.pose][3:5] == ["3 of s1", "0 of s2"]


def calibrate(*arguments: object) -> int:
    return run("rig-calibrate", command, [str(argument) for argument in arguments])


def test_two_files_give_one_result(tmp_path, simulated_description, capsys):
    paths = [
        write_measured_session(tmp_path / f"s{seed}.h5", simulated_description, seed=seed, n_poses=10)
        for seed in (0, 10)
    ]
    assert calibrate(*paths) == 0
    result = yaml.safe_load(Path(tmp_path / "s0+s10.calib.yaml").read_text())
    assert [session["name"] for session in result["sessions"]] == ["s0", "s10"]
    assert all(session["n_poses"] == 10 for session in result["sessions"])
    assert "session" not in result
    assert result["evaluation"]["rmse_m"] < 0.002
    assert "s10" in capsys.readouterr().out
    assert calibrate(paths[0]) == 0
    assert calibrate("--compare", tmp_path / "s0.calib.yaml", tmp_path / "s0+s10.calib.yaml") == 0
    assert "both rest on the same session" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("options", "reason"),
    [(["--method", "ours-2"], "one session at a time"), (["--follow"], "take one session"), ([], "the same session")],
)
def test_what_does_not_go_with_several_is_said(tmp_path, simulated_description, capsys, options, reason):
    path = write_measured_session(tmp_path / "s1.h5", simulated_description)
    assert calibrate(path, path, *options) == 2
    assert reason in capsys.readouterr().err
