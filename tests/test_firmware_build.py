"""The firmware as it is built: its size, the images that the wheel carries, and the parser under fuzzing."""

# ruff: noqa: T201 - figures for whoever runs `pytest -s`
import re
import subprocess
from pathlib import Path

import pytest
from simboard import BUILD, FIRMWARE, firmware, make

BOARDS = ["uno", "nano", "mega"]
IMAGES = FIRMWARE.parent / "acquire" / "images"
VERSION = re.search(r'FIRMWARE_VERSION "(.+)"', (FIRMWARE / "buzzer_board" / "config.h").read_text())


def used_bytes(board: str) -> tuple[int, int]:
    """Return the flash and the memory that a board's firmware uses."""
    report = subprocess.run(["avr-size", firmware(board)], capture_output=True, text=True, check=True)
    text, initialised, zeroed = (int(number) for number in report.stdout.splitlines()[1].split()[:3])
    return text + initialised, initialised + zeroed


@pytest.mark.parametrize("board", BOARDS)
def test_the_firmware_is_small(board):
    flash_bytes, memory_bytes = used_bytes(board)
    print(f"{board}: {flash_bytes} bytes of flash, {memory_bytes} bytes of memory before the stack")
    assert flash_bytes <= 16 * 1024
    assert memory_bytes <= 1024


def hex_content(path: Path) -> bytes:
    """Return the bytes of an Intel hex file that starts at 0 and has no holes."""
    records = [bytes.fromhex(line[1:]) for line in path.read_text().split()]
    return b"".join(record[4:-1] for record in records if record[3] == 0)


@pytest.mark.parametrize("board", BOARDS)
def test_the_image_that_the_wheel_carries_is_of_these_sources(board):
    carried = hex_content(IMAGES / f"buzzer-board-{board}.hex")
    compiler = subprocess.run(["avr-gcc", "-dumpversion"], capture_output=True, text=True, check=True).stdout.strip()
    if compiler == "5.4.0":  # the one that made the images
        assert carried == hex_content(firmware(board, "hex")), "the sources changed: make -C firmware images"
    assert VERSION is not None
    assert f"fw={VERSION[1]} ".encode() in carried, "the version changed: make -C firmware images"


@pytest.mark.parametrize("seed", [1, 2])
def test_the_parser_survives_a_million_bytes_of_fuzzing(seed):
    make("fuzz")
    command = [BUILD / "fuzz_parser", FIRMWARE / "frames.txt", "1000000", str(seed)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    print(run.stdout)
    assert run.returncode == 0, run.stderr
    n_bytes, n_lines, n_plays = (int(number) for number in re.findall(r"\d+", run.stdout)[:3])
    assert n_bytes >= 1_000_000
    assert n_lines > 10_000
    assert n_plays > 100  # it got to the inside, not only to the door
