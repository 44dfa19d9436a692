"""`rig-session` and how every command ends."""

import errno
import os
import subprocess
import sys
from io import StringIO

import click
import h5py
import pytest
from example_sessions import N_CHANNELS, TRUTH, add_pose, measured, new_session, samples, write_session

from rigs.cli import cli
from rigs.command import run
from rigs.errors import SessionError
from rigs.session import layout


def info(capsys, *arguments):
    exit_code = run("rig-session", cli, ["info", *map(str, arguments)])
    return exit_code, *capsys.readouterr()


def test_info_tells_what_a_session_holds(tmp_path, capsys):
    path = tmp_path / "s.h5"
    with new_session(path, truth=TRUTH, **measured()) as writer:
        add_pose(writer, 0)
        add_pose(writer, 1, accepted=False)
        writer.append_audio(samples(), host_time_s=0.0, adc_time_s=0.0, flags=layout.FLAG_GAP)
        writer.append_log(0.0, "warning", "channel 3 is quiet")
        writer.append_log(0.0, "info", "done")
    exit_code, out, err = info(capsys, path, "--verify")
    lines = dict(line.split(maxsplit=1) for line in out.splitlines())
    assert (exit_code, err) == (0, "")
    assert lines["session"] == "sésame"
    assert lines["complete"] == "yes"
    assert lines["audio"] == f"0.1 s, {N_CHANNELS} channels, 48000 Hz, samples lost before 1 of 5 blocks"
    assert lines["frames"] == "4"
    assert lines["poses"] == "1 accepted of 2"
    assert lines["emissions"] == "2 accepted of 4"
    assert lines["measured"] == "corners of 2 poses, TDOAs of 4 emissions x 7 pairs"
    assert lines["truth"] == "yes, from simulation"
    assert lines["log"] == "2 lines, 1 warnings, 0 errors"
    assert lines["checksums"] == "all good"


def test_info_verify_finds_damage(tmp_path, capsys):
    path = write_session(tmp_path / "s.h5", n_poses=12)
    with h5py.File(path, "r+") as file:
        file[layout.TIME_DATA][:] = 0
    assert info(capsys, path)[0] == 0
    exit_code, out, _ = info(capsys, path, "--verify")
    assert exit_code == 5
    assert "audio block 0 is damaged" in out
    assert "and 14 more" in out
    assert "remedy     `rig-session recover FILE -o NEW.h5`" in out


def test_info_shows_hostile_text_harmlessly(tmp_path, capsys):
    path = write_session(tmp_path / "s.h5", name="\x1b[2Jboo[bold]", versions={"a": "b\x07\nc"})
    _, out, _ = info(capsys, path)
    assert "\x1b" not in out
    assert "\x07" not in out
    assert "boo[bold]" in out


def test_info_of_a_bad_file_is_one_line(tmp_path, capsys):
    exit_code, out, err = info(capsys, tmp_path / "none.h5")
    assert (exit_code, out) == (5, "")
    assert err == f"rig-session: {tmp_path}/none.h5: no such file: name a session file, such as s1.h5\n"


@pytest.mark.parametrize("arguments", [[], ["info"], ["info", "a", "b"], ["nonsense"], ["info", "--nonsense", "a"]])
def test_wrong_usage_is_exit_code_2(arguments, capsys):
    assert run("rig-session", cli, arguments) == 2
    assert "Usage" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "exit_code", "words"),
    [
        (SessionError("a.h5: bad"), 5, "rig: a.h5: bad"),
        (OSError(errno.ENOSPC, "x", "/a/b"), 2, "rig: /a/b: No space left on device: free some space"),
        (PermissionError(errno.EACCES, "x", "/a"), 2, "rig: /a: Permission denied: check the permissions"),
        (KeyboardInterrupt(), 130, "rig: interrupted"),
        (
            ZeroDivisionError("oh\nno"),
            1,
            "rig: a fault in this software: ZeroDivisionError: oh no; set RIG_TRACEBACK=1",
        ),
    ],
)
def test_every_error_is_one_line_and_an_exit_code(error, exit_code, words, capsys, monkeypatch):
    monkeypatch.delenv("RIG_TRACEBACK", raising=False)

    @click.command()
    def failing():
        raise error

    assert run("rig", failing, []) == exit_code
    err = capsys.readouterr().err.strip()
    assert err.startswith(words)
    assert "\n" not in err


def test_a_terminal_that_is_gone_changes_no_exit_code(monkeypatch):
    class Terminal(StringIO):
        def write(self, _):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def failing():
        raise SessionError("a.h5: bad")

    monkeypatch.setattr(sys, "stderr", Terminal())
    assert run("rig", click.Command("x", callback=failing), []) == 5


def test_exit_code_is_what_a_command_returns():
    assert run("rig", click.Command("x", callback=lambda: 130), []) == 130
    assert run("rig", click.Command("x", callback=lambda: None), []) == 0
    assert run("rig", click.Command("x", callback=lambda: sys.exit(4)), []) == 4


def test_traceback_is_there_when_wanted(monkeypatch):
    monkeypatch.setenv("RIG_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        run("rig", click.Command("x", callback=lambda: 1 / 0), [])


def test_help_imports_nothing_heavy():
    code = "import rigs.cli, sys; sys.exit(str({'h5py', 'cv2', 'scipy', 'pydantic', 'rich'} & set(sys.modules) or ''))"
    ended = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert ended.stderr.strip() == ""
