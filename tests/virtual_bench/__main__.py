"""`python -m virtual_bench`: run the bench until Ctrl-C, and say how to capture a session at it."""

from __future__ import annotations

import argparse
import os
import select
import signal
import sys
from contextlib import suppress
from pathlib import Path

from rigs.library import find_description
from virtual_bench.bench import ENVIRONMENT_FILE, RIG_FILE, Bench, virtual_bench

_AUTOGROUP = Path("/proc/self/autogroup")
_NICENESS = "-10"


def main() -> None:
    """Run the bench."""
    parser = argparse.ArgumentParser(prog="virtual_bench", description="A bench without hardware; Ctrl-C ends it.")
    parser.add_argument("--folder", type=Path, default=Path("virtual-bench"), help="where its files go")
    parser.add_argument("--rig", default="virtual", help="a rig description with drivers serial, portaudio, opencv")
    parser.add_argument("--seed", type=int, help="another array, room and board places")
    parser.add_argument("--port", type=int, default=0, help="of the camera's address; 0: any that is free")
    options = parser.parse_args()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    description = find_description(options.rig).description
    seed = description.simulation.seed if options.seed is None else options.seed
    _stand_for_hardware()
    for ending in (signal.SIGTERM, signal.SIGHUP):  # the terminal may be closed
        signal.signal(ending, signal.default_int_handler)
    parent = os.getppid()
    fault = None
    with suppress(KeyboardInterrupt), virtual_bench(description, folder, seed=seed, port=options.port) as bench:
        _say(folder)
        while os.getppid() == parent and not fault:  # whoever started it may be killed, and could not end it then
            fault = _live(bench)
    if fault:
        sys.exit(f"virtual_bench: {fault}: start the bench again")


def _live(bench: Bench) -> str | None:
    """Let the bench live for a while, do what is typed, and return what has died and cannot be put back."""
    with suppress(BrokenPipeError):
        bench.run_for(0.5)
    if bench.plugs.board.has_died():
        bench.plugs.board.pull_out()
        _tell("the simulated board has ended; type b to put it back")
    for letter in _typed():
        _tell(bench.plugs.toggle(letter))
    return bench.plugs.fault()


def _typed() -> list[str]:
    """Return the letters that were typed, with Enter; none without a terminal."""
    if not sys.stdin or not sys.stdin.isatty() or not select.select([sys.stdin], [], [], 0)[0]:
        return []
    return sys.stdin.readline().split()


def _tell(text: str) -> None:
    print(text, flush=True)  # noqa: T201


def _stand_for_hardware() -> None:
    """Come before other programs, as a busy computer does not slow hardware down; where Linux allows it."""
    if os.getsid(0) == os.getpid():  # a session of its own, so that nothing else is meant
        with suppress(OSError):
            _AUTOGROUP.write_text(_NICENESS)


def _say(folder: Path) -> None:
    print(  # noqa: T201
        "the bench runs; Ctrl-C ends it. In another terminal:\n"
        f"  . {folder / ENVIRONMENT_FILE}\n"
        f"  rig-capture --session s1 --rig {folder / RIG_FILE}\n"
        "Here: b, c or s and Enter pull out the board, the camera or the sound, and put it back.",
        flush=True,
    )


if __name__ == "__main__":
    main()
