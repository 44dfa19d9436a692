"""Emission times from the trigger board's sync output: found in the sound, and used in the joint problem."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from capturing import captured, small_rig
from conftest import BUZZERS_M
from measured_rig import CHANNELS, Rig, make_rig

from calib.cli import command
from calib.emissions import accepted_rows
from calib.joint.assemble import assemble
from calib.joint.bias import without_bias
from calib.joint.robust import solve_robustly
from calib.joint.session import answer_jointly
from calib.joint.start import find_start
from calib.joint.uncertainty import microphone_rms_m, shared_covariance
from calib.settings import Settings
from calib.sound import find_arrivals
from rigs.command import run
from rigs.session.reader import Session

LATENCIES_S = 1e-4 * np.arange(1, 7)
SYNC_STD_S = 0.2e-6


def with_sync(rig: Rig, tdoas, seed: int = 0, share_wrong: float = 0.0):
    """Add when each emission began, a latency of its buzzer earlier; some of it wrong."""
    generator = np.random.default_rng([seed, 11])
    began_s = np.arange(len(rig.arrival_s)) - np.tile(LATENCIES_S, len(rig.arrival_s) // len(BUZZERS_M))
    onset_s = began_s + SYNC_STD_S * generator.standard_normal(len(began_s))
    onset_s += 1e-3 * generator.standard_normal(len(began_s)) * (generator.random(len(began_s)) < share_wrong)
    sound = replace(tdoas.sound, onset_s=onset_s, onset_std_s=np.full(len(began_s), SYNC_STD_S))
    return replace(tdoas, sound=sound)


def solved(rig: Rig, **changes):
    tdoas = with_sync(rig, rig.tdoas, **{key: changes.pop(key) for key in ("share_wrong", "seed") if key in changes})
    problem, guess = assemble(rig.description, rig.view(), rig.corners, tdoas, CHANNELS, **changes)
    solution = solve_robustly(problem, find_start(problem, guess, 0).at)
    return solution, shared_covariance(problem, solution.at, solution.weights())


def rms_m(solution, rig: Rig) -> float:
    return float(np.sqrt(np.mean(np.sum(rig.errors_m(solution) ** 2, axis=1))))


def test_known_onsets_have_no_bias_of_their_own():
    """A good session's bias is nothing beside its standard deviation, with onsets too."""
    solution, covariance = solved(make_rig(0, n_poses=8))
    moved_m = without_bias(solution.problem, solution.at, solution.weights()).microphones_m - solution.at.microphones_m
    assert 0 < np.abs(moved_m).max() < 0.02 * microphone_rms_m(covariance, 8)


def test_a_sync_output_that_is_seen_only_later_makes_no_odds():
    """`--follow` goes on from a solve without latencies."""
    rig = make_rig(0, n_poses=6)

    def answer(tdoas, **before):
        return answer_jointly(rig.description, rig.view(), rig.corners, tdoas, CHANNELS, Settings(), **before)

    found = answer(with_sync(rig, rig.tdoas), before=answer(rig.tdoas, is_last=False).continuation)
    np.testing.assert_allclose(found.microphones_m, answer(with_sync(rig, rig.tdoas)).microphones_m, atol=1e-6)


def test_the_equations_of_onsets_match_numeric_derivatives():
    rig = make_rig(0, n_poses=4)
    problem, _ = assemble(
        rig.description, rig.view(), rig.corners, with_sync(rig, rig.tdoas), CHANNELS, find_delays=True
    )
    at = rig.truth.with_latencies(6)
    rest = np.random.default_rng(0).standard_normal(at.blocks.size)
    shared = at.shared.copy()
    shared[at.blocks.microphones] += 1e-3 * rest[at.blocks.microphones]
    shared[at.blocks.latencies] = LATENCIES_S + 1e-6
    at, arrivals = replace(at, shared=shared), problem.stated_weights().arrivals
    own = problem.onsets.weights(problem.arrivals, at, arrivals)

    def equations(values):
        return problem.onsets.normal_equations(problem.arrivals, values, arrivals, own)

    whole = equations(at)
    steps = np.full(at.blocks.size, 1e-7)
    steps[at.blocks.delays], steps[at.blocks.latencies], steps[at.blocks.speed] = 1e-9, 1e-9, 1e-4
    for place in (*range(52), *range(at.blocks.latencies.start, at.blocks.size)):
        step = np.zeros(at.blocks.size)
        step[place] = steps[place]
        costs = [equations(at.moved(sign * step, np.zeros((4, 6)))).cost for sign in (-1, 1)]
        numeric = -(costs[1] - costs[0]) / (2 * steps[place])
        tolerance = 1e-6 * np.abs(whole.shared_gradient).max() * min(1.0, 1e-9 / steps[place])
        assert numeric == pytest.approx(whole.shared_gradient[place], rel=1e-4, abs=tolerance)
    for pose, place in [(0, 1), (2, 3), (3, 5)]:
        step = np.zeros((4, 6))
        step[pose, place] = 1e-7
        costs = [equations(at.moved(np.zeros(at.blocks.size), sign * step)).cost for sign in (-1, 1)]
        assert -(costs[1] - costs[0]) / 2e-7 == pytest.approx(whole.pose_gradient[pose, place], rel=1e-4)


def test_a_known_emission_time_counts_by_what_its_arrivals_leave_open():
    """Its own variance, and that of the weighted mean of the arrivals."""
    rig = make_rig(0, n_poses=4)
    problem, _ = assemble(rig.description, rig.view(), rig.corners, with_sync(rig, rig.tdoas), CHANNELS)
    at, arrivals = rig.truth.with_latencies(6), problem.arrivals
    onsets = replace(problem.onsets, onset_s=np.average(arrivals.offsets_s(at), axis=1, weights=arrivals.information))
    variances_s2 = SYNC_STD_S**2 + 1 / arrivals.information.sum(axis=1)
    np.testing.assert_allclose(onsets.weights(arrivals, at, arrivals.information), 1 / variances_s2, rtol=1e-6)


def test_known_emission_times_are_worth_what_the_bound_says():
    gains, squares, errors = [], [], []
    for seed in range(6):
        rig = make_rig(seed, n_poses=12)
        solution, covariance = solved(rig, seed=seed)
        plain, plain_covariance = solved(rig, seed=seed, ignore_sync=True)
        assert plain.problem.onsets is None
        gains.append(microphone_rms_m(plain_covariance, 8) / microphone_rms_m(covariance, 8))
        error_m = rig.errors_m(solution).ravel()
        squares.append(error_m @ np.linalg.solve(covariance[:24, :24], error_m) / 24)
        errors.append((rms_m(solution, rig), rms_m(plain, rig)))
        found_s = solution.at.shared[solution.at.blocks.latencies]
        latency_std_s = np.sqrt(np.diag(covariance)[solution.at.blocks.latencies])
        assert (np.abs(found_s - LATENCIES_S) < 4 * latency_std_s).all()
    assert min(gains) > 1
    assert 0.6 < np.mean(squares) < 1.6  # 1 is exact
    with_and_without_m = np.sqrt(np.mean(np.square(errors), axis=0))
    assert with_and_without_m[0] < with_and_without_m[1]


def test_wrong_emission_times_cost_little():
    rig = make_rig(3, n_poses=15)
    good, _ = solved(rig)
    spoilt, _ = solved(rig, share_wrong=0.2)
    assert rms_m(spoilt, rig) < 1.5 * rms_m(good, rig)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("sync") / "s1.h5"
    buzzers = [{"id": 1 + n, "position_m": place} for n, place in enumerate(BUZZERS_M.tolist())]
    rig = small_rig(
        audio={"sync_channel": 10}, board={"buzzers": buzzers, "buzzer_std_m": 0.0001}, capture={"poses": 6}
    )
    captured(path, rig, seed=2)
    return path


def test_the_sync_output_is_found_in_the_sound(path):
    """Arrivals less the sync output are times of flight, but for one number per buzzer."""
    with Session.open(path) as session:
        rows = accepted_rows(session)
        sound = find_arrivals(session, rows, "matched")
        emissions, truth = session.emissions[rows], session.truth
        poses = np.array(truth.board_to_camera)[emissions["pose"]]
        sources_m = (
            np.einsum("eij,ej->ei", poses[:, :3, :3], truth.buzzers_m[emissions["buzzer"] - 1]) + poses[:, :3, 3]
        )
        flights_s = np.linalg.norm(truth.microphones_m - sources_m[:, None], axis=2) / truth.speed_of_sound_m_s
    late_s = sound.arrival_s - sound.onset_s[:, None] - flights_s
    for buzzer in range(1, 7):
        own = late_s[emissions["buzzer"] == buzzer]
        assert np.nanstd(own) < 0.5e-6
        assert abs(np.nanmean(own)) < 3e-3
    assert np.nanmax(sound.onset_std_s) < 1e-6


def test_a_session_with_a_sync_channel_is_better_for_it(path, tmp_path):
    results = {}
    for name, options in (("with", []), ("without", ["--ignore-sync"])):
        target = tmp_path / f"{name}.yaml"
        assert run("rig-calibrate", command, [str(path), "-o", str(target), *options]) == 0
        results[name] = yaml.safe_load(target.read_text())
    stds_m = {name: np.mean([mic["std_m"] for mic in result["microphones"]]) for name, result in results.items()}
    assert stds_m["with"] < stds_m["without"]
    assert results["with"]["evaluation"]["rmse_m"] < 0.001
    assert results["with"]["warnings"] == results["without"]["warnings"] == []


def test_a_sync_channel_that_carries_nothing_is_told(tmp_path):
    dead = {"faults": [{"kind": "dead_channel", "channel": 10}], "rt60_s": 0.0}
    rig = small_rig(audio={"sync_channel": 10}, simulation=dead, capture={"poses": 2})
    captured(tmp_path / "s2.h5", rig, seed=2)
    with Session.open(tmp_path / "s2.h5") as session:
        from calib.emissions import measure_tdoas

        warnings = measure_tdoas(session).warnings
    assert any("channel 10 has the board's sync output in 0% of the emissions only" in each for each in warnings)
