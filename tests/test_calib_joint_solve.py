"""The joint solve: its start, its accuracy against the bound, and what it withstands."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import MICROPHONES_M, make_world
from measured_rig import CHANNELS, Rig, bent_rig, make_rig
from scipy.stats import chi2

from calib.baseline.gauss_newton import gauss_newton
from calib.errors import NotEnoughDataError
from calib.joint.bias import without_bias
from calib.joint.descend import descend
from calib.joint.pairs import arrivals_of_pairs
from calib.joint.robust import JointSolution, _not_settled, solve_robustly
from calib.joint.search import descend_together
from calib.joint.start import closed_form, find_start, range_table
from calib.joint.suspects import find_suspects
from calib.joint.uncertainty import microphone_covariances, microphone_rms_m, shared_covariance
from calib.problem import Estimate, TdoaProblem

PAPER = ("speed", "buzzers", "scale", "intrinsics", "poses")


def rms_m(rig: Rig, solution: JointSolution) -> float:
    return float(np.sqrt(np.mean(np.sum(rig.errors_m(solution) ** 2, axis=1))))


def test_closed_form_is_exact_without_noise():
    rig = make_rig(0, arrival_std_s=1e-15)
    problem, _ = rig.assembled(hold=PAPER)
    np.testing.assert_allclose(closed_form(range_table(problem, rig.truth)), rig.truth.microphones_m, atol=1e-4)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_start_lands_in_the_right_basin(share):
    for seed in range(5):
        rig = make_rig(seed, arrival_std_s=2e-5).with_outliers(share)
        start = find_start(*rig.assembled(), seed=0)
        assert np.abs(start.at.microphones_m - rig.truth.microphones_m).max() < 0.1
        assert start.rival_m is None


def test_start_is_the_same_whatever_the_seed():
    problem, guess = make_rig(3).assembled()
    first, second = (find_start(problem, guess, seed).at.microphones_m for seed in (0, 1))
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_a_mirror_image_is_told():
    """All sources in one plane: which side of it a microphone is on cannot be known."""
    rig = make_rig(0)
    problem, guess = rig.assembled(hold=PAPER)
    shared = guess.shared.copy()
    shared[guess.blocks.buzzers.start + np.arange(2, 18, 3)] = 0.0
    flat = replace(
        guess,
        rotations=np.broadcast_to(np.eye(3), guess.rotations.shape),
        translations_m=guess.translations_m * (1, 1, 0) + (0, 0, 0.6),
        shared=np.where(
            np.isin(np.arange(guess.blocks.size), guess.blocks.buzzers.start + np.arange(2, 18, 3)), 0.0, guess.shared
        ),
    )
    flights_s = problem.arrivals.flights(flat.placed(MICROPHONES_M)).times_s
    noise_s = 1e-7 * np.random.default_rng(0).standard_normal(flights_s.shape)
    planar = replace(problem, arrivals=replace(problem.arrivals, arrival_s=flights_s + noise_s))
    assert find_start(planar, flat, 0).rival_m is not None


def test_start_refuses_nothing_at_all():
    problem, guess = make_rig(0, n_poses=6).assembled()
    silent = replace(
        problem, arrivals=replace(problem.arrivals, arrival_s=np.full_like(problem.arrivals.arrival_s, np.nan))
    )
    with pytest.raises(NotEnoughDataError, match="0 emissions were heard"):
        find_start(silent, guess, seed=0)
    twice = np.arange(len(problem.arrivals.pose)) < 2
    with pytest.raises(NotEnoughDataError, match="2 emissions were heard"):
        find_start(replace(problem, arrivals=problem.arrivals.only(twice)), guess, seed=0)


def test_a_microphone_that_is_known_exactly_stays_where_it_is():
    rig = make_rig(0, arrival_std_s=5e-6)
    problem, guess = rig.assembled()
    std = problem.priors.std.copy()
    std[guess.blocks.microphone(7)] = 0.0
    guess = guess.placed(np.where(np.arange(8)[:, None] == 7, rig.truth.microphones_m, 0.0))
    known = replace(problem, priors=replace(problem.priors, mean=guess.shared, std=std))
    solution = solve_robustly(known, find_start(known, guess, 0).at)
    np.testing.assert_array_equal(solution.at.microphones_m[7], rig.truth.microphones_m[7])


def test_start_needs_no_emission_that_all_microphones_heard():
    """Each emission misses one microphone, in turn."""
    rig = make_rig(1)
    arrival_s = rig.arrival_s.copy()
    arrival_s[np.arange(len(arrival_s)), np.arange(len(arrival_s)) % 8] = np.nan
    holed = replace(rig, arrival_s=arrival_s)
    assert rms_m(holed, holed.solved()) < 0.002


def test_the_bound_is_reached_and_the_ellipsoids_hold():
    """Everything that the rig description admits to know badly is wrong by as much."""
    squares, bounds, held = [], [], []
    for seed in range(30):
        rig = make_rig(seed)
        solution = rig.solved()
        errors_m = rig.errors_m(solution)
        covariance = shared_covariance(solution.problem, solution.at, solution.weights())
        squares.append(np.mean(np.sum(errors_m**2, axis=1)))
        bounds.append(microphone_rms_m(rig.bound(), 8) ** 2)
        held += [
            error @ np.linalg.solve(ellipsoid, error) < chi2.ppf(0.95, 3)
            for error, ellipsoid in zip(errors_m, microphone_covariances(covariance, 8), strict=True)
        ]
    assert np.sqrt(np.mean(squares) / np.mean(bounds)) < 1.10
    assert np.sqrt(np.median(squares)) < 0.0005
    assert 0.92 < np.mean(held) < 0.985  # the 240 ellipsoids are not independent


def test_the_scatter_is_right_where_measurements_are_few():
    """Four microphones, four poses: what the unknowns take of the residuals is given back, no less and no more."""
    ratios, few = [], [0, 2, 5, 7]
    for seed in range(20):
        rig = make_rig(seed, n_poses=4)
        problem, guess = rig.assembled(channels=tuple(CHANNELS[row] for row in few))
        solution = solve_robustly(problem, guess.placed(rig.truth.microphones_m[few]))
        noise_s = rig.assembled()[0].arrivals.offsets_s(rig.truth)[:, few]
        noise_s -= np.average(noise_s, axis=1, weights=problem.arrivals.information)[:, None]
        drawn = np.sum(problem.arrivals.information * noise_s**2) / (noise_s.size - len(noise_s))
        ratios.append(solution.scales.arrivals**2 / drawn)
    assert abs(np.mean(ratios) - 1) < 0.03


def test_a_bent_board_is_found():
    """Its corners are a millimetre out of the plane: the bound is reached, taking it as flat costs as much again."""
    found, taken_as_flat, bounds = [], [], []
    for seed in range(6):
        rig = make_rig(seed, description=bent_rig())
        found.append(rms_m(rig, rig.solved()) ** 2)
        taken_as_flat.append(rms_m(rig, rig.solved(hold=("corners",))) ** 2)
        bounds.append(microphone_rms_m(rig.bound(), 8) ** 2)
    assert np.sqrt(np.mean(found) / np.mean(bounds)) < 1.15
    assert np.mean(taken_as_flat) > 2 * np.mean(found)


@pytest.mark.parametrize(("share", "factor"), [(0.1, 1.3), (0.3, 2.0)])
def test_gross_outliers_cost_little(share, factor):
    clean, spoilt = [], []
    for seed in range(6):
        rig = make_rig(seed)
        worse = rig.with_outliers(share, seed)
        solution = worse.solved()
        clean.append(rms_m(rig, rig.solved()) ** 2)
        spoilt.append(rms_m(worse, solution) ** 2)
        wrong = np.abs(solution.residuals_s()) > 20 * rig.std_s
        assert not solution.used_arrivals[wrong].any()
    assert np.sqrt(np.mean(spoilt) / np.mean(clean)) < factor


def test_the_papers_problem_is_the_joint_one_with_all_else_held():
    world = make_world(noise_s=1e-5)
    rig = make_rig(0)
    problem, _ = rig.assembled(hold=PAPER)
    ideal = replace(rig.truth, shared=problem.priors.mean)
    flights = problem.arrivals.flights(ideal)
    arrival_s = problem.arrivals.flights(ideal.placed(MICROPHONES_M)).times_s
    arrival_s = arrival_s + 1e-5 * np.random.default_rng(0).standard_normal(arrival_s.shape)
    alike = replace(problem.arrivals, arrival_s=arrival_s, std_s=np.full_like(arrival_s, 1e-5))
    problem = replace(problem, arrivals=alike)
    joint = descend(problem, ideal.placed(MICROPHONES_M), problem.stated_weights()).end
    pairs = world.problem.pairs
    tdoas = TdoaProblem(
        sources_m=flights.arms_m + ideal.translations_m[problem.arrivals.pose],
        pose=problem.arrivals.pose.astype(np.int32),
        tdoa_s=arrival_s[:, pairs[:, 1]] - arrival_s[:, pairs[:, 0]],
        pairs=pairs,
        n_mics=8,
        known_m=np.zeros((0, 3)),
    )
    paper = gauss_newton(tdoas, Estimate(MICROPHONES_M, ideal.speed_m_s), 1e-10).estimate
    np.testing.assert_allclose(joint.microphones_m, paper.microphones_m, atol=1e-7)
    batch = descend_together(range_table(problem, ideal), MICROPHONES_M[None] + 0.05, least_squares=40, robust=0)
    np.testing.assert_allclose(batch.places_m[0], paper.microphones_m, atol=1e-6)


@pytest.mark.parametrize("fault", ["none", "buzzer", "delay", "squares"])
def test_what_is_not_as_described_is_found(fault):
    rig = make_rig(4)
    board = rig.description.board
    expected = {"none": [], "buzzer": [("buzzer", 2)], "delay": [("delay", 5)], "squares": [("scale", 0)]}[fault]
    if fault == "buzzer":
        x, y, z = board.buzzers[2].position_m
        moved = board.buzzers[2].model_copy(update={"position_m": (x - 0.012, y + 0.016, z)})
        board = board.model_copy(update={"buzzers": (*board.buzzers[:2], moved, *board.buzzers[3:])})
    if fault == "squares":
        board = board.model_copy(update={"square_size_m": 1.05 * board.square_size_m})
    late_s = np.where(np.arange(8) == 5, 2e-4, 0.0) if fault == "delay" else 0.0
    rig = replace(
        rig, description=rig.description.model_copy(update={"board": board}), arrival_s=rig.arrival_s + late_s
    )
    solution, suspects = find_suspects(rig.solved())
    assert [(suspect.kind, suspect.number) for suspect in suspects] == expected
    assert rms_m(rig, solution) < 0.001


def test_pairs_that_do_not_close_are_left_out():
    world = make_world(noise_s=1e-6, n_poses=12)
    generator = np.random.default_rng(0)
    wrong = generator.random(world.problem.tdoa_s.shape) < 0.1
    spoilt = np.where(wrong, generator.uniform(-2e-3, 2e-3, wrong.shape), world.problem.tdoa_s)
    arrival_s, _, agree = arrivals_of_pairs(spoilt, world.problem.pairs, 8)
    assert (agree & wrong).sum() < 0.02 * wrong.sum()
    assert (~agree & ~wrong).sum() < 0.02 * wrong.size
    errors_s = arrival_s - np.column_stack([np.zeros(72), world.problem.tdoa_s[:, :7]])
    assert np.nanmax(np.abs(errors_s - np.nanmedian(errors_s, axis=1, keepdims=True))) < 1e-5


def test_pairs_on_a_grid_keep_their_rounding():
    """Triples of rounded TDOAs close exactly or by a step: that is no outlier."""
    world = make_world(n_poses=12)
    step_s = 1 / 24000
    _, _, agree = arrivals_of_pairs(np.round(world.problem.tdoa_s / step_s) * step_s, world.problem.pairs, 8)
    assert agree.mean() > 0.98


def test_the_bias_is_taken_away():
    """At centimetres of scatter answers are too far away on average: less so once the bias is taken away."""
    before, after = [], []
    problem, guess = make_rig(0).assembled(hold=PAPER)
    truth = guess.placed(MICROPHONES_M)
    std_s = np.full_like(problem.arrivals.std_s, 1.5e-4)
    times_s = problem.arrivals.flights(truth).times_s
    for seed in range(60):
        noise_s = std_s * np.random.default_rng(seed).standard_normal(std_s.shape)
        noisy = replace(problem, arrivals=replace(problem.arrivals, arrival_s=times_s + noise_s, std_s=std_s))
        best = descend(noisy, truth, noisy.stated_weights()).end
        corrected = without_bias(noisy, best, noisy.stated_weights())
        before.append(best.microphones_m - MICROPHONES_M)
        after.append(corrected.microphones_m - MICROPHONES_M)
    assert np.mean(np.square(after)) < 0.98 * np.mean(np.square(before))
    assert np.linalg.norm(np.mean(after, axis=0)) < 0.8 * np.linalg.norm(np.mean(before, axis=0))


def test_a_microphone_that_nothing_places_is_refused():
    rig = make_rig(0, n_poses=6)
    problem, _ = rig.assembled()
    arrival_s = problem.arrivals.arrival_s.copy()
    arrival_s[:, 3] = np.nan
    deaf = replace(problem, arrivals=replace(problem.arrivals, arrival_s=arrival_s))
    with pytest.raises(NotEnoughDataError, match="do not determine"):
        shared_covariance(deaf, rig.truth, deaf.stated_weights())


def test_same_measurements_same_answer():
    rig = make_rig(2)
    np.testing.assert_allclose(rig.solved().at.microphones_m, rig.solved().at.microphones_m, atol=1e-9)


def test_given_start_does_not_matter():
    rig = make_rig(5)
    problem, guess = rig.assembled()
    near = solve_robustly(problem, rig.truth).at.microphones_m
    np.testing.assert_allclose(
        solve_robustly(problem, find_start(problem, guess, 0).at).at.microphones_m, near, atol=1e-6
    )


def test_too_few_microphones_are_the_reason_where_nothing_settles():
    for n_mics, words in ((2, "leave fewer channels out"), (8, "capture more")):
        problem = SimpleNamespace(arrivals=SimpleNamespace(arrival_s=np.zeros((6, n_mics))))
        assert words in str(_not_settled(100, problem))
