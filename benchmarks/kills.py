"""SIGKILL at 200 random moments of a capture, half of them in the middle of a write, and 200 power losses."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from crash_images import logged_session, power_losses  # noqa: E402
from killed_captures import kills  # noqa: E402

from rigs.session.recover import recover  # noqa: E402

N = int(sys.argv[1]) if len(sys.argv) > 1 else 200


def survived_kills(folder: Path, n: int) -> int:
    """Return how many of n killed captures kept what they must."""
    complaints: list[str] = []
    seed = 0
    while len(complaints) < n:  # some end before their kill comes
        (folder / str(seed)).mkdir()
        for kill in kills(folder / str(seed), n - len(complaints), seed):
            complaints.append(kill.complaint())
            _keep(kill.path.parent, complaints[-1])
        seed += 1
    return complaints.count("")


def survived_power_losses(folder: Path, n: int) -> tuple[int, int]:
    """Return how many of n images keep all that was synced: with the journal, and by HDF5 alone."""
    complaints, alone = [], 0
    for image in power_losses(logged_session(folder, n_poses=150), n, seed=0):
        path = image.write(folder)
        alone += not image.complaint(path)
        recover(path, path.with_name("copy.h5"))
        complaints.append(image.complaint(path.with_name("copy.h5")))
        _keep(path.parent, complaints[-1])
    return complaints.count(""), alone


def _keep(folder: Path, complaint: str) -> None:
    """Print the complaint, if there is one, and keep the files that it is about."""
    if complaint:
        kept = Path(mkdtemp(prefix=f"{folder.name}-"))
        shutil.copytree(folder, kept, dirs_exist_ok=True)
        Console().print(f"{complaint}; kept in {kept}")


def main() -> None:
    """Print the table."""
    table = Table(title="crash safety", title_justify="left")
    for column in ("figure", "limit", "measured"):
        table.add_column(column, justify="left" if column == "figure" else "right")
    with TemporaryDirectory() as folder:
        good = survived_kills(Path(folder), N)
    table.add_row("killed captures that recover: all good poses, at most 1 s lost", f"{N} of {N}", f"{good} of {N}")
    with TemporaryDirectory() as folder:
        good, alone = survived_power_losses(Path(folder), N)
    table.add_row("power losses that keep all that was synced", f"{N} of {N}", f"{good} of {N}")
    table.add_row("the same without the journal", "", f"{alone} of {N}")
    Console().print(table)


if __name__ == "__main__":
    main()
