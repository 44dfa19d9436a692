"""SIGKILL at 200 random moments of a capture, half of them in the middle of a write, and 200 power losses."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from crash_images import Image, logged_session, power_losses  # noqa: E402
from killed_captures import kills  # noqa: E402

from rigs.errors import SessionError  # noqa: E402
from rigs.session.reader import Session  # noqa: E402
from rigs.session.recover import recover  # noqa: E402

N = int(sys.argv[1]) if len(sys.argv) > 1 else 200


def survived_kills(folder: Path, n: int) -> tuple[int, int]:
    """Return how many captures were killed, and how many of them kept what they must."""
    complaints: list[str] = []
    seed = 0
    while len(complaints) < n:  # some end before their kill comes
        (folder / str(seed)).mkdir()
        complaints += [kill.complaint() for kill in kills(folder / str(seed), n - len(complaints), seed)]
        seed += 1
    for complaint in filter(None, complaints):
        Console().print(complaint)
    return len(complaints), complaints.count("")


def survived_power_losses(folder: Path, n: int) -> tuple[int, int, int]:
    """Return how many images there were, and how many keep all that was synced: with the journal, by HDF5 alone."""
    journal = alone = 0
    for number, image in enumerate(power_losses(logged_session(folder, n_poses=150), n, seed=0)):
        there = folder / str(number)
        there.mkdir()
        path = image.write(there)
        alone += _holds_all(path, image)
        recover(path, there / "copy.h5")
        journal += _holds_all(there / "copy.h5", image)
    return n, journal, alone


def _holds_all(path: Path, image: Image) -> bool:
    try:
        with Session.open(path) as session:
            lengths = (session.n_samples, len(session.frames), len(session.poses))
            wanted = (image.n_samples, image.n_frames, image.n_poses)
            return all(has >= want for has, want in zip(lengths, wanted, strict=True)) and not session.verify()
    except SessionError:
        return False


def main() -> None:
    """Print the table."""
    table = Table(title="crash safety", title_justify="left")
    for column in ("figure", "limit", "measured"):
        table.add_column(column, justify="left" if column == "figure" else "right")
    with TemporaryDirectory() as folder:
        n, good = survived_kills(Path(folder), N)
    table.add_row("killed captures that recover: all good poses, at most 1 s lost", f"{n} of {n}", f"{good} of {n}")
    with TemporaryDirectory() as folder:
        n, good, alone = survived_power_losses(Path(folder), N)
    table.add_row("power losses that keep all that was synced", f"{n} of {n}", f"{good} of {n}")
    table.add_row("the same without the journal", "", f"{alone} of {n}")
    Console().print(table)


if __name__ == "__main__":
    main()
