"""The joint solve: accuracy against the Cramer-Rao bound, what it withstands, and speed.

Run by `make bench`; `--rounds 1000` tells the paper's simulation more closely. Speeds are ratios within this one run.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from conftest import AISLAB, BUZZERS_M, board_poses
from measured_rig import Rig, bent_rig, make_rig

from calib.joint.arrivals import ArrivalTable
from calib.joint.bias import without_bias
from calib.joint.descend import descend
from calib.joint.problem import JointProblem, Priors
from calib.joint.robust import solve_robustly
from calib.joint.search import RangeTable, descend_together
from calib.joint.start import find_start, range_table
from calib.joint.suspects import find_suspects
from calib.joint.threads import on_one_thread
from calib.joint.uncertainty import microphone_covariances, microphone_rms_m, shared_covariance
from calib.joint.unknowns import Unknowns
from rigs.geometry import Pose
from rigs.session.aislab_files import read_poses

Spoil = Callable[[Rig, np.random.Generator], tuple[Rig, list[tuple[str, int]]]]
DIVERGENT_M = 2.0  # a microphone this far off: the optimum is at infinity, and a mean tells nothing
LEVELS_S = {1: 66.6e-6, 2: 333e-6, 3: 999e-6, 4: 1332e-6}
PAPER_BUZZERS_M = np.array([(200, 0, 2), (-40, 0, 2), (200, 140, 2), (-40, 140, 2), (200, 60, 2), (-40, 60, 2)]) / 1e3
CUBE_M = 0.5 * np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def rms_m(errors_m: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors_m**2, axis=1))))


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def simulated_rig(seeds: int) -> None:
    print(f"Simulated rig at the level of corners and arrivals, {seeds} seeds, mm")
    print(f"{'':40}{'bound':>8}{'rmse':>8}{'ratio':>8}{'median':>8}{'largest':>9}{'95 % hold':>11}{'speed':>9}")
    cases: dict[str, Callable[[int], Rig]] = {
        "25 poses, 0.25 to 1 us, 0.05 px": make_rig,
        "12 poses, 0.5 to 2 us, 0.05 px": partial(make_rig, n_poses=12, arrival_std_s=1e-6),
        "25 poses, a board bent by 1 mm": partial(make_rig, description=bent_rig()),
    }
    for name, make in cases.items():
        errors, bounds, held, times_s = [], [], [], []
        for seed in range(seeds):
            rig = make(seed)
            start_s = time.perf_counter()
            solution = rig.solved()
            covariance = shared_covariance(solution.problem, solution.at, solution.weights())
            times_s.append(time.perf_counter() - start_s)
            errors.append(rms_m(rig.errors_m(solution)))
            bounds.append(microphone_rms_m(rig.bound(), 8))
            ellipsoids = microphone_covariances(covariance, 8)
            pulls = [error @ np.linalg.solve(matrix, error) for error, matrix in
                     zip(rig.errors_m(solution), ellipsoids, strict=True)]  # fmt: skip
            held.append(np.mean(np.array(pulls) < chi2.ppf(0.95, 3)))
        rmse, bound = rms(errors), rms(bounds)
        print(f"{name:40}{1e3 * bound:8.3f}{1e3 * rmse:8.3f}{rmse / bound:8.3f}{1e3 * np.median(errors):8.3f}"
              f"{1e3 * max(errors):9.3f}{100 * np.mean(held):10.1f}%{1e3 * np.median(times_s):6.0f} ms")  # fmt: skip


def outliers(seeds: int) -> None:
    print(f"\nGross outliers among the arrivals, {seeds} seeds, mm; bound: of a rig without them")
    print(f"{'share':>8}{'bound':>8}{'rmse':>8}{'over none':>11}{'largest':>9}")
    bound_m = rms([microphone_rms_m(make_rig(seed).bound(), 8) for seed in range(seeds)])
    clean_m = None
    for share in (0.0, 0.1, 0.3):
        rigs = [make_rig(seed).with_outliers(share, seed) for seed in range(seeds)]
        errors_m = [rms_m(rig.errors_m(rig.solved())) for rig in rigs]
        clean_m = clean_m or rms(errors_m)
        print(f"{share:8.0%}{1e3 * bound_m:8.3f}{1e3 * rms(errors_m):8.3f}{rms(errors_m) / clean_m:11.3f}"
              f"{1e3 * max(errors_m):9.3f}")  # fmt: skip


def wrong_buzzer(rig: Rig, generator: np.random.Generator) -> tuple[Rig, list[tuple[str, int]]]:
    board, number = rig.description.board, int(generator.integers(6))
    direction = generator.standard_normal(3)
    place_m = np.array(board.buzzers[number].position_m) + 0.02 * direction / np.linalg.norm(direction)
    buzzers = list(board.buzzers)
    buzzers[number] = buzzers[number].model_copy(update={"position_m": tuple(place_m)})
    return with_board(rig, buzzers=tuple(buzzers)), [("buzzer", number)]


def late_channel(rig: Rig, generator: np.random.Generator) -> tuple[Rig, list[tuple[str, int]]]:
    number = int(generator.integers(8))
    return replace(rig, arrival_s=rig.arrival_s + 2e-4 * (np.arange(8) == number)), [("delay", number)]


def wrong_squares(rig: Rig, generator: np.random.Generator) -> tuple[Rig, list[tuple[str, int]]]:
    size_m = rig.description.board.square_size_m * float(generator.choice([0.95, 1.05]))
    return with_board(rig, square_size_m=size_m), [("scale", 0)]


def with_board(rig: Rig, **changes: object) -> Rig:
    board = rig.description.board.model_copy(update=changes)
    return replace(rig, description=rig.description.model_copy(update={"board": board}))


def faults(seeds: int) -> None:
    print(f"\nFaults found and named, and nothing else, of {seeds} seeds; mm; bound: of a rig without them")
    print(f"{'':30}{'found':>6}{'bound':>8}{'rmse':>8}{'median':>8}")
    bound_m = rms([microphone_rms_m(make_rig(seed).bound(), 8) for seed in range(seeds)])
    kinds: dict[str, Spoil] = {
        "none": lambda rig, _: (rig, []),
        "a buzzer off by 20 mm": wrong_buzzer,
        "a channel late by 0.2 ms": late_channel,
        "squares off by 5 %": wrong_squares,
    }
    for name, spoil in kinds.items():
        found, errors = 0, []
        for seed in range(seeds):
            rig, expected = spoil(make_rig(seed), np.random.default_rng([seed, 2]))
            solution, suspects = find_suspects(rig.solved())
            found += [(suspect.kind, suspect.number) for suspect in suspects] == expected
            errors.append(rms_m(rig.errors_m(solution)))
        print(f"{name:30}{found:6}{1e3 * bound_m:8.3f}{1e3 * rms(errors):8.3f}{1e3 * np.median(errors):8.3f}")


def paper_problem(poses: list[Pose]) -> tuple[JointProblem, Unknowns]:
    """Return the paper's simulation without noise: only the microphones are unknown."""
    truth = Unknowns.of(CUBE_M, 340.0, PAPER_BUZZERS_M, np.zeros(9), poses)
    std = np.zeros(truth.blocks.size)
    std[truth.blocks.microphones] = np.inf
    pose, buzzer = np.repeat(np.arange(len(poses)), 6), np.tile(np.arange(6), len(poses))
    table = ArrivalTable(pose, buzzer, np.zeros((len(pose), 8)), np.ones((len(pose), 8)))
    table = replace(table, arrival_s=table.flights(truth).times_s)
    return JointProblem(table, None, Priors(truth.shared, std, poses_held=True)), truth


def drawn(ideal: JointProblem, number: int, level: int) -> JointProblem:
    """Return the paper's simulation with Gaussian noise, each TDOA's standard deviation that of the level."""
    std_s = np.full_like(ideal.arrivals.std_s, LEVELS_S[level] / np.sqrt(2))
    noise_s = std_s * np.random.default_rng([number, level]).standard_normal(std_s.shape)
    table = replace(ideal.arrivals, arrival_s=ideal.arrivals.arrival_s + noise_s, std_s=std_s)
    return replace(ideal, arrivals=table)


def paper_round(problem: JointProblem, truth: Unknowns) -> tuple[np.ndarray, bool, float]:
    """Return errors (8, 3) from no first guess, whether it was the global optimum, and the time it took."""
    start_s = time.perf_counter()
    start = find_start(problem, truth.placed(np.zeros((8, 3))), 0).at
    ranges = range_table(problem, truth)
    found = descend_together(ranges, start.microphones_m[None], least_squares=80, robust=0)
    places_m = without_bias(problem, truth.placed(found.places_m[0]), problem.stated_weights()).microphones_m
    time_s = time.perf_counter() - start_s
    best = descend_together(ranges, CUBE_M[None], least_squares=80, robust=0)
    is_best = bool(np.sum(found.residuals**2) <= np.sum(best.residuals**2) * (1 + 1e-6))
    return places_m - CUBE_M, is_best, time_s


def paper_simulation(rounds: int) -> None:
    if AISLAB.is_dir():
        poses = read_poses(AISLAB)
    else:
        print("\n(the published poses are not here: random ones instead)")
        poses = board_poses(69, 0)
    ideal, truth = paper_problem(poses)
    print(f"\nThe paper's simulation, Gaussian noise, no first guess, {rounds} rounds, mm")
    print(f"{'level':>8}{'bound':>9}{'rmse':>9}{'ratio':>16}{'median':>9}{'global':>9}{'divergent':>11}{'speed':>9}")
    for level in LEVELS_S:
        problem = drawn(ideal, 0, level)
        bound_m = microphone_rms_m(shared_covariance(problem, truth, problem.stated_weights()), 8)
        done = [paper_round(drawn(ideal, number, level), truth) for number in range(rounds)]
        errors_m = np.array([rms_m(error) for error, _, _ in done])
        ratio, spread = np.sqrt(np.mean(errors_m**2)) / bound_m, np.std(errors_m**2) / np.sqrt(rounds) / 2 / bound_m**2
        rmse = f"{1e3 * ratio * bound_m:9.1f}{ratio:8.3f} +- {spread / ratio:5.3f}"
        divergent = np.mean(errors_m > DIVERGENT_M)
        print(f"{level:8}{1e3 * bound_m:9.1f}{rmse if divergent == 0 else ' ' * 25}"
              f"{1e3 * np.median(errors_m):9.1f}{sum(best for _, best, _ in done):9}{divergent:11.1%}"
              f"{1e3 * np.median([time_s for _, _, time_s in done]):6.0f} ms", flush=True)  # fmt: skip


def timed_ms(action: Callable[[], object], repeats: int = 5) -> float:
    times_s = []
    for _ in range(repeats):
        start_s = time.perf_counter()
        action()
        times_s.append(time.perf_counter() - start_s)
    return 1e3 * float(np.min(times_s))


def speed() -> None:
    print("\nSpeed, 69 poses, 414 emissions, 8 microphones (one run; ratios count)")
    ideal, truth = paper_problem(board_poses(69, 0))
    table = range_table(ideal, truth)
    noisy = table.ranges_m + 0.005 * np.random.default_rng(0).standard_normal(table.ranges_m.shape)
    table = RangeTable(table.sources_m, noisy, np.ones_like(noisy))
    start_m = CUBE_M + 0.05

    first, second = np.triu_indices(8, k=1)

    def residuals(places: np.ndarray) -> np.ndarray:
        rays_m = places.reshape(8, 3) - table.sources_m[:, None]
        offsets_m = table.ranges_m - np.sqrt(np.einsum("emi,emi->em", rays_m, rays_m))
        return np.asarray(offsets_m[:, second] - offsets_m[:, first]).ravel()

    scipy_ms = timed_ms(lambda: least_squares(residuals, start_m.ravel()))
    ours_ms = timed_ms(lambda: descend_together(table, start_m[None], least_squares=30, robust=0))
    print(
        f"paper's problem: scipy least_squares {scipy_ms:.1f} ms, ours {ours_ms:.1f} ms, {scipy_ms / ours_ms:.0f} times"
    )
    rig = make_rig(0, n_poses=69)
    problem, guess = rig.assembled()
    start_ms = timed_ms(lambda: find_start(problem, guess, 0), 3)
    start = find_start(problem, guess, 0).at
    solve_ms = timed_ms(lambda: solve_robustly(problem, start), 3)
    solution = solve_robustly(problem, start)
    suspects_ms = timed_ms(lambda: find_suspects(solution), 3)
    print(f"full joint problem: start {start_ms:.0f} ms, robust solve {solve_ms:.0f} ms, suspects {suspects_ms:.0f} ms")
    print("time per iteration of the full problem with 64 microphones")
    for n_poses in (125, 250, 500, 1000, 2000):
        print(f"{n_poses:8} poses {iteration_ms(n_poses):9.0f} ms, {iteration_ms(n_poses) / n_poses:6.2f} ms per pose")


def iteration_ms(n_poses: int) -> float:
    """Return the time of one linearisation and step with 64 microphones."""
    microphones_m = np.random.default_rng(0).uniform(-0.3, 0.3, (64, 3))
    rig = make_rig(0, n_poses=n_poses, microphones_m=microphones_m)
    pose, buzzer = np.repeat(np.arange(n_poses), len(BUZZERS_M)), np.tile(np.arange(len(BUZZERS_M)), n_poses)
    small, _ = make_rig(0, n_poses=6).assembled()
    std = np.full(rig.truth.blocks.size, np.inf)
    std[rig.truth.blocks.delays], std[rig.truth.blocks.speed], std[rig.truth.blocks.buzzers] = 0.0, 0.6, 1e-4
    std[rig.truth.blocks.scale] = 2e-4
    assert small.corners is not None
    corners = replace(small.corners, seen_px=rig.corners_px)
    problem = JointProblem(ArrivalTable(pose, buzzer, rig.arrival_s, rig.std_s), corners, Priors(rig.truth.shared, std))
    return timed_ms(lambda: descend(problem, rig.truth, problem.stated_weights(), 1), 1) / 2


@on_one_thread
def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=200, help="of the paper's simulation; 1000 take a while")
    chosen = parser.parse_args()
    simulated_rig(chosen.seeds)
    outliers(chosen.seeds)
    faults(chosen.seeds)
    paper_simulation(chosen.rounds)
    speed()


if __name__ == "__main__":
    main()
