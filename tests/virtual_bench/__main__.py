"""`python -m virtual_bench`: run the bench until Ctrl-C, and say how to capture a session at it."""

from __future__ import annotations

import argparse
import os
import signal
from contextlib import suppress
from pathlib import Path

from rigs.library import find_description
from virtual_bench.bench import ENVIRONMENT_FILE, RIG_FILE, virtual_bench

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
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    parent = os.getppid()
    with suppress(KeyboardInterrupt), virtual_bench(description, folder, seed=seed, port=options.port) as bench:
        _say(folder)
        while os.getppid() == parent:  # whoever started it may be killed, and could not end it then
            bench.run_for(1.0)


def _stand_for_hardware() -> None:
    """Come before other programs, as a busy computer does not slow hardware down; where Linux allows it."""
    if os.getsid(0) == os.getpid():  # a session of its own, so that nothing else is meant
        with suppress(OSError):
            _AUTOGROUP.write_text(_NICENESS)


def _say(folder: Path) -> None:
    print(  # noqa: T201
        "the bench runs; Ctrl-C ends it. In another terminal:\n"
        f"  . {folder / ENVIRONMENT_FILE}\n"
        f"  rig-capture --session s1 --rig {folder / RIG_FILE}",
        flush=True,
    )


if __name__ == "__main__":
    main()
