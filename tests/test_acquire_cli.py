"""The command line rig-capture: its exit codes, its lines, its displays, and its end by a signal."""

import errno
import os
import signal
import subprocess
import sys
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from capturing import captured, rig_text, small_description, small_rig
from rich.console import Console

from acquire import cli as cli_module
from acquire.cli import cli
from acquire.screen import LiveScreen, PlainScreen, picture, screen_for
from acquire.status import Message, State, Status
from rigs.command import run, wrapped
from rigs.description import MIN_POSES, MIN_POSES_FOR_INTRINSICS
from rigs.session.reader import Session

COMMAND = [sys.executable, "-c", "from acquire.cli import main; main()"]


@pytest.fixture
def rig_file(tmp_path):
    def write(**sections):
        path = tmp_path / "rig.yaml"
        path.write_text(rig_text(small_description(**sections)), encoding="utf-8")
        return str(path)

    return write


def rig_capture(*arguments):
    return run("rig-capture", cli, [str(argument) for argument in arguments])


def test_a_capture_says_what_it_uses_what_it_saved_and_what_comes_next(tmp_path, rig_file, capsys):
    assert rig_capture("--session", tmp_path / "s1", "--rig", rig_file(), "--poses", 1) == 0
    printed = capsys.readouterr().out
    assert f"rig test, from {tmp_path / 'rig.yaml'}: named by --rig" in printed
    assert "pose 1 of 1 is good: 2 of 2 emissions heard" in printed
    assert f"1 pose saved in {tmp_path / 's1.h5'}" in printed
    assert printed.endswith("rig-calibrate needs at least 6 poses, 25 are good\n")
    with Session.open(tmp_path / "s1.h5") as session:
        assert session.name == "s1"


INTRINSICS = {"focal_px": (500.0, 500.0), "principal_px": (319.5, 239.5), "distortion": (0.0,) * 5}


@pytest.mark.parametrize(
    ("intrinsics", "n_needed"), [("from session", MIN_POSES_FOR_INTRINSICS), (INTRINSICS, MIN_POSES)]
)
def test_calibrating_is_named_next_once_there_are_poses_enough(tmp_path, rig_file, capsys, intrinsics, n_needed):
    rig = rig_file(camera={"intrinsics": intrinsics})
    for n_poses, comes_next in (
        (n_needed - 1, f"next: capture a session with more poses: rig-calibrate needs at least {n_needed} poses, "),
        (n_needed, f"next: rig-calibrate {tmp_path / f's{n_needed}.h5'}\n"),
    ):
        assert rig_capture("--session", tmp_path / f"s{n_poses}", "--rig", rig, "--poses", n_poses) == 0
        assert comes_next in capsys.readouterr().out


@pytest.mark.parametrize(("name", "shown"), [("my demo", "'my demo.h5'"), ("-x", "./-x.h5"), ("$HOME", "'$HOME.h5'")])
def test_the_next_command_can_be_copied_as_it_is(name, shown):
    assert cli_module._next_line(9, 3, cli_module._session_path(Path(name))) == f"next: rig-calibrate {shown}"


def test_silent_channels_and_buzzers_are_told_at_the_end():
    """The next command is one that will work: a silent channel is left out of it."""
    status = Status("rig", "s.h5", (1, 2, 3), 6, 6, saved=6, faults={3: "silent", 1: "clipped"})
    status.fired.update({1: 6, 2: 6})
    status.missed.update({1: 1, 2: 6})
    lines = cli_module._fault_lines(status)
    assert next(line for line in lines if "buzzer" in line).startswith("warning: buzzer 2 was not heard 6 of 6 times")
    assert len(lines) == 3
    comes_next = cli_module._next_line(6, 3, Path("s.h5"), status.silent)
    assert comes_next == "next: rig-calibrate s.h5 --exclude-channel 3"


@pytest.mark.parametrize("name", ["two\nlines", "\x1b[31mred", "bad\udcff"])
def test_a_name_that_cannot_be_shown_is_refused_in_one_line(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    assert rig_capture("--session", name) == 2
    error = capsys.readouterr().err
    assert "has a sign that cannot be shown" in error
    assert name not in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [".", "..", "", "/"])
@pytest.mark.parametrize("arguments", [[], ["--resume"]])
def test_a_folder_is_no_session(capsys, name, arguments):
    assert rig_capture("--session", name, *arguments) == 2
    assert "a folder, not a file: name a file" in capsys.readouterr().err


def test_channels_at_fault_until_the_end_are_named_last(tmp_path, rig_file, capsys):
    rig = rig_file(simulation={"faults": [{"kind": "dead_channel", "channel": 3}]})
    assert rig_capture("--session", tmp_path / "s1", "--rig", rig, "--poses", 1) == 0
    last = capsys.readouterr().out.splitlines()[-2:]
    assert last[0].startswith("warning: channel 3 was silent until the end: check its cable")
    assert last[0].endswith("rig-calibrate --exclude-channel 3")
    assert last[1].startswith("next: ")


def test_the_default_rig_is_named_as_such(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RIG", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    assert rig_capture("--session", "s1.h5", "--poses", 1) == 0
    assert (
        "rig simulated, from simulated.yaml (shipped): the default, as nothing else is named by --rig"
        in capsys.readouterr().out
    )


def test_an_existing_session_is_refused(tmp_path, rig_file, capsys):
    (tmp_path / "s1.h5").write_text("precious")
    assert rig_capture("--session", tmp_path / "s1", "--rig", rig_file()) == 2
    assert capsys.readouterr().err.startswith(f"rig-capture: {tmp_path / 's1.h5'}: there is already something")
    assert (tmp_path / "s1.h5").read_text() == "precious"


@pytest.mark.parametrize(
    ("arguments", "exit_code"),
    [([], 2), (["--session", "x", "--poses", "0"], 2), (["--session", "x", "--rig", "no/such.yaml"], 2)],
)
def test_wrong_usage_and_a_missing_description_are_exit_code_2(tmp_path, monkeypatch, arguments, exit_code):
    monkeypatch.chdir(tmp_path)
    assert rig_capture(*arguments) == exit_code
    assert not list(tmp_path.iterdir())


def test_a_lost_device_is_exit_code_3_and_one_line(tmp_path, rig_file, capsys):
    rig = rig_file(simulation={"faults": [{"kind": "camera_lost", "pose": 1}]})
    assert rig_capture("--session", tmp_path / "s1", "--rig", rig) == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"; 1 pose saved in {tmp_path / 's1.h5'}" in error


def test_a_board_that_is_not_found_is_exit_code_5(tmp_path, rig_file, capsys):
    rig = rig_file(capture={"pose_timeout_s": 0.2})
    assert rig_capture("--session", tmp_path / "s1", "--rig", rig) == 5
    assert "bring the whole board into the picture" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_a_good_file(tmp_path, rig_file, number):
    arguments = ["--session", str(tmp_path / "s1"), "--rig", rig_file(), "--poses", "5000"]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        COMMAND + arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as capturing:
        for line in capturing.stdout:
            if "pose 2 of 5000 is good" in line:
                capturing.send_signal(number)
                break
        _, error = capturing.communicate(timeout=60)
    assert capturing.returncode == 130
    assert error.count("\n") == 1
    with Session.open(tmp_path / "s1.h5") as session:
        assert session.complete
        assert session.verify() == []
        saved = np.count_nonzero(session.poses["accepted"])
    assert saved >= 2
    assert f"stopped on request; {saved} poses saved in {tmp_path / 's1.h5'}" in error


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from acquire.cli import cli; from rigs.command import run; run('rig-capture', cli, ['--help']);"
        "sys.exit(','.join({'cv2', 'h5py', 'scipy', 'numpy', 'pydantic', 'rich', 'yaml'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stderr.strip() == ""
    assert "Exit code: 0 good" in done.stdout


def a_status(n_channels=8):
    status = Status("bench", "s1.h5", tuple(range(1, n_channels + 1)), 25, 6)
    status.state, status.saved, status.buzzer, status.emission = State.FIRING, 7, 3, 3
    status.advice, status.board, status.faults = "leave the board where it is", "still (0.08 px)", {3: "silent"}
    status.hear(np.full((10, n_channels), 0.1, dtype=np.float32), 0.1)
    status.messages.append(Message(62.0, "warning", "channel 3 is silent in every emission: check its cable"))
    return status


def drawn(status, width, height):
    console = Console(file=StringIO(), width=width, height=height, force_terminal=True, color_system=None)
    console.print(picture(status, width, height), end="")
    return console.file.getvalue().splitlines()


@pytest.mark.parametrize(("n_channels", "width", "height"), [(8, 80, 24), (8, 120, 40), (56, 120, 40), (256, 80, 24)])
def test_the_display_fits_the_terminal(n_channels, width, height):
    shown = drawn(a_status(n_channels), width, height)
    assert len(shown) < height
    assert max(map(len, shown)) <= width
    text = "\n".join(shown)
    for part in (
        "7 of 25 saved",
        "3 (3 of 6)",
        "still (0.08 px)",
        "ch 1 ",
        "-20 dBFS",
        "silent",
        "leave the board",
        "1:02",
    ):
        assert part in text


def test_the_display_says_how_many_channels_it_cannot_show():
    assert any("more channels" in line for line in drawn(a_status(256), 80, 24))


def test_the_meters_fall_slowly_and_survive_nan():
    status = a_status()
    status.hear(np.full((10, 8), np.nan, dtype=np.float32), 0.5)
    np.testing.assert_allclose(status.level_dbfs, -35.0, atol=0.01)


def test_a_terminal_gets_the_live_display_and_a_pipe_plain_lines():
    assert isinstance(screen_for(Console(file=StringIO(), force_terminal=True)), LiveScreen)
    assert isinstance(screen_for(Console(file=StringIO())), PlainScreen)


def test_the_live_display_ends_with_the_last_state(tmp_path):
    console = Console(file=StringIO(), width=80, height=24, force_terminal=True, color_system=None)
    with LiveScreen(console) as screen:
        captured(tmp_path / "s.h5", small_rig(), poses=1, screen=screen)
    last = console.file.getvalue().rsplit("rig-capture", maxsplit=1)[1]
    assert "finished" in last
    assert "1 of 1 saved" in last


@pytest.mark.parametrize("screen_kind", [LiveScreen, PlainScreen])
def test_a_terminal_that_is_gone_does_not_end_the_capture(tmp_path, screen_kind):
    class Terminal(StringIO):
        n_writes = 0

        def write(self, text):
            self.n_writes += 1
            if self.n_writes > 3:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return super().write(text)

    terminal = Terminal()
    with screen_kind(Console(file=terminal, width=80, height=24, force_terminal=True)) as screen:
        captured(tmp_path / "s.h5", small_rig(), poses=1, screen=screen)
    assert terminal.n_writes > 3
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete


def test_the_live_display_shows_how_far_a_copy_is():
    console = Console(file=StringIO(), width=80, height=24, force_terminal=True, color_system=None)
    rows = np.zeros(3, dtype=[("pose", "<i4")])
    rows["pose"] = range(3)
    with LiveScreen(console) as screen:
        assert [row["pose"] for row in screen.watch(rows, "copying sound")] == [0, 1, 2]
    assert "copying sound" in console.file.getvalue()


@pytest.mark.parametrize("width", range(30, 80, 7))
def test_a_long_line_breaks_between_words_and_never_in_a_command(width):
    command = "rig-flash --port /dev/pts/0"
    line = f"rig-capture: no answer; is this the buzzer board? If not, put ours on it: {command} (or another); go on"
    lines = wrapped(line, width)
    assert lines.replace("\n", " ") == line
    assert sum(command in each for each in lines.split("\n")) == 1
    assert max(map(len, lines.split("\n"))) < width


@pytest.mark.parametrize("left_behind", [True, False])
def test_a_thread_that_was_left_behind_does_not_outlive_the_program(left_behind):
    code = (
        "import atexit, threading, time; from rigs.command import leave; atexit.register(print, 'taken down');"
        f"threading.Thread(target=time.sleep, args=(60 * {left_behind},), daemon={left_behind}).start();"
        "print('said'); leave(130)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 130
    assert done.stdout.split("\n") == (["said", ""] if left_behind else ["said", "taken down", ""])
