"""Arrival times against peers: accuracy in simulated rooms, the Cramer-Rao bound, speed and memory.

Run by `make bench`. Rooms are pyroomacoustics' own; so is one of the peers. Speeds are ratios within this one run.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import cast

import numpy as np
from pyroomacoustics.experimental import tdoa as pra_tdoa

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from room_sound import RATE_HZ, RoomSound, Scenario, make_room_sound, write_room_session

from calib.consistency import agree
from calib.emissions import measure_tdoas
from calib.gcc import PairCorrelator, joined
from calib.sound import TdoaMode, find_arrivals
from rigs.session.reader import Session

PAIRS = np.array(list(combinations(range(8), 2)), dtype=np.int32)
MAX_TDOA_S = 0.005
SCENARIOS = {
    "0.5 m, 20 dB, RT60 0.5 s, sweep": Scenario("sweep", 0.5, 20.0, 0.5, n_poses=12, seed=11, max_order=40),
    "0.5 m, 20 dB, RT60 0.5 s, MLS": Scenario("mls", 0.5, 20.0, 0.5, n_poses=12, seed=12, max_order=40),
    "2 m, 0 dB, RT60 0.5 s, sweep": Scenario("sweep", 2.0, 0.0, 0.5, n_poses=25, seed=13, max_order=40),
    "2 m, 0 dB, RT60 0.5 s, MLS": Scenario("mls", 2.0, 0.0, 0.5, n_poses=25, seed=14, max_order=40),
}


def accuracy() -> None:
    print("TDOA errors of all pairs, microseconds")
    print(f"{'':34}{'median':>9}{'95 %':>9}{'largest':>10}{'> 20 us':>9}{'rejected':>10}")
    for name, scenario in SCENARIOS.items():
        made = make_room_sound(scenario)
        print(f"{name}; Cramer-Rao bound of the median {1e6 * 0.674 * np.sqrt(2) * np.median(made.bound_s):.3f}")
        methods = {
            "rig-calibrate, matched": ours(made, "matched"),
            "rig-calibrate, gcc-phat": ours(made, "gcc-phat"),
            "pyroomacoustics tdoa, PHAT, 16-fold": pair_by_pair(made, phat=True),
            "pyroomacoustics tdoa, plain, 16-fold": pair_by_pair(made, phat=False),
        }
        for method, tdoa_s in methods.items():
            row(method, made, tdoa_s)


def row(method: str, made: RoomSound, tdoa_s: np.ndarray) -> None:
    truth_s = made.arrival_s[: len(tdoa_s), PAIRS[:, 1]] - made.arrival_s[: len(tdoa_s), PAIRS[:, 0]]
    errors = 1e6 * np.abs(tdoa_s - truth_s)
    kept = errors[np.isfinite(errors)]
    print(
        f"  {method:32}{np.median(kept):>9.3f}{np.percentile(kept, 95):>9.2f}{kept.max():>10.1f}"
        f"{np.mean(kept > 20):>9.2%}{1 - len(kept) / errors.size:>10.2%}"
    )


def ours(made: RoomSound, mode: TdoaMode) -> np.ndarray:
    with (
        tempfile.TemporaryDirectory() as folder,
        Session.open(write_room_session(Path(folder) / "s.h5", made)) as session,
    ):
        return measure_tdoas(session, mode).tdoa_s


def windows(made: RoomSound) -> np.ndarray:
    """Return what the peers get: 0.22 s around each emission."""
    n_before, n_samples = round(0.06 * RATE_HZ), round(0.22 * RATE_HZ)
    return np.array([made.sound[first - n_before :][:n_samples].T for first in made.expected_sample])


def pair_by_pair(made: RoomSound, *, phat: bool) -> np.ndarray:
    """Every pair of the first emissions."""
    return np.array(
        [
            [pra_tdoa(window[j], window[i], interp=16, fs=RATE_HZ, phat=phat) for i, j in PAIRS]
            for window in windows(made)[:12]
        ]
    )


def bound() -> None:
    print("\nAnechoic, 25 poses of six buzzers: scatter over the Cramer-Rao bound, chi-square of the stated deviations")
    print(f"{'':34}{'0 dB':>14}{'10 dB':>14}{'20 dB':>14}{'30 dB':>14}{'40 dB':>14}")
    for signal in ("sweep", "mls"):
        cells = []
        for snr_db in (0.0, 10.0, 20.0, 30.0, 40.0):
            made = make_room_sound(Scenario(signal, rt60_s=0.0, snr_db=snr_db, n_poses=25, seed=int(snr_db) + 21))
            cells.append(anechoic_cell(made))
        print(f"  {signal:32}" + "".join(f"{cell:>14}" for cell in cells))


def anechoic_cell(made: RoomSound) -> str:
    with (
        tempfile.TemporaryDirectory() as folder,
        Session.open(write_room_session(Path(folder) / "s.h5", made)) as session,
    ):
        sound = find_arrivals(session, np.arange(len(made.pose)), "matched")
    against = [reduced_chi_square(sound.arrival_s - made.arrival_s, std_s) for std_s in (made.bound_s, sound.std_s)]
    return f"{np.sqrt(against[0]):.3f}, {against[1]:.2f}"


def reduced_chi_square(errors_s: np.ndarray, std_s: np.ndarray) -> float:
    """Of arrivals about their weighted mean."""
    weights = 1 / std_s**2
    rest = errors_s - (errors_s * weights).sum(axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)
    return float(np.sum(rest**2 * weights) / (7 * len(rest)))


def speed() -> None:
    print("\n414 emissions x 8 channels x 0.5 s at 48 kHz, all 28 pairs; the peer 16-fold, ours finer; one thread each")
    made = make_room_sound(Scenario(n_poses=3, seed=5, max_order=10))
    with session_of(made) as session:
        long = long_session(session, made, 414 // len(made.pose))
    rows = np.arange(len(long.emissions))
    sound = np.array([long.audio(first - 8000, RATE_HZ // 2).T for first in long.emissions["expected_sample"]])
    noise = np.full((8, RATE_HZ // 4 + 1), made.sound[:4800].var() * RATE_HZ / 2)
    correlator = PairCorrelator(RATE_HZ // 2, noise, MAX_TDOA_S * RATE_HZ)

    def half_seconds() -> None:
        parts = [correlator.candidates(sound[begin : begin + 2]) for begin in range(0, len(sound), 2)]
        agree(joined(parts), PAIRS, 8)

    def a_few_pairs() -> None:
        for i, j in PAIRS[:12]:
            pra_tdoa(sound[0, j], sound[0, i], interp=16, fs=RATE_HZ)

    jobs: dict[str, Callable[[], object]] = {
        "pyroomacoustics tdoa, pair by pair": a_few_pairs,
        "rig-calibrate, gcc-phat, from the session": lambda: find_arrivals(long, rows, "gcc-phat"),
        "rig-calibrate, matched, from the session": lambda: find_arrivals(long, rows, "matched"),
        "gcc-phat alone on whole windows of 0.5 s": half_seconds,
    }
    times = best_of_rounds(jobs, n_rounds=5)
    times["pyroomacoustics tdoa, pair by pair"] *= 28 / 12 * len(rows)
    theirs = times["pyroomacoustics tdoa, pair by pair"]
    print(f"  {'':44}{'wall':>9}{'ratio':>9}{'processor':>12}{'ratio':>9}")
    for name, (wall, processor) in times.items():
        print(f"  {name:44}{wall:>7.2f} s{theirs[0] / wall:>9.1f}{processor:>10.2f} s{theirs[1] / processor:>9.1f}")


def best_of_rounds(jobs: dict[str, Callable[[], object]], n_rounds: int) -> dict[str, np.ndarray]:
    """Return the shortest wall and processor time of each job; they take turns, so that all meet the same load."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in jobs}
    for _ in range(n_rounds):
        for name, job in jobs.items():
            begin, cpu = time.perf_counter(), time.process_time()
            job()
            times[name].append((time.perf_counter() - begin, time.process_time() - cpu))
    return {name: np.min(taken, axis=0) for name, taken in times.items()}


class LongSession:
    """Sound that repeats itself, read like a session's; nothing of it is kept in memory but one tile."""

    def __init__(self, session: Session, made: RoomSound, n_tiles: int) -> None:
        self.description, self.channels = session.description, session.channels
        self.sample_rate_hz, self.microphone_columns = session.sample_rate_hz, session.microphone_columns
        self._tile = made.sound
        self.n_samples = n_tiles * len(made.sound)
        self.emissions = np.concatenate([session.emissions] * n_tiles)
        self.emissions["expected_sample"] += np.repeat(np.arange(n_tiles) * len(made.sound), len(made.pose))

    def audio(self, first_sample: int, n_samples: int) -> np.ndarray:
        first_sample %= len(self._tile)
        parts = [self._tile[first_sample : first_sample + n_samples]]
        parts.append(self._tile[: n_samples - len(parts[0])])
        return np.concatenate(parts)


def long_session(session: Session, made: RoomSound, n_tiles: int) -> Session:
    """Return a `LongSession` for functions that want a session; it has all that those which find arrivals look at."""
    return cast(Session, LongSession(session, made, n_tiles))


@contextmanager
def session_of(made: RoomSound) -> Iterator[Session]:
    with tempfile.TemporaryDirectory() as folder:
        path = write_room_session(Path(folder) / "s.h5", made)
        with Session.open(path) as session:
            yield session


def memory() -> None:
    made = make_room_sound(Scenario(n_poses=2, seed=5, max_order=5))
    with (
        tempfile.TemporaryDirectory() as folder,
        Session.open(write_room_session(Path(folder) / "s.h5", made)) as session,
    ):
        long = long_session(session, made, 3600 * RATE_HZ // len(made.sound))
    begin = time.perf_counter()
    sound = find_arrivals(long, np.arange(len(long.emissions)), "matched")
    status = Path("/proc/self/status").read_text()  # getrusage would tell the parent's peak
    peak_mb = int(status.split("VmHWM:")[1].split()[0]) / 1024
    found = np.isfinite(sound.arrival_s).mean()
    print(f"\nAn hour of sound, {len(long.emissions)} emissions, {found:.1%} of the arrivals found")
    print(f"  {time.perf_counter() - begin:.1f} s, peak memory of the process {peak_mb:.0f} MB")


if __name__ == "__main__":
    if sys.argv[1:] == ["memory"]:
        memory()
    else:
        accuracy()
        bound()
        speed()
        sys.stdout.flush()
        subprocess.run([sys.executable, __file__, "memory"], check=True)
