"""A command: how every command line of the project ends, with a good exit code and never with a traceback."""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn

import click

from rigs.errors import reason

INTERRUPTED = 130
_CONFIGURATION = 2
_FAULT = 1
_WORDS = re.compile(r"rig-[a-z]+(?: +-[^;,()]*[^;,() ])|\S+")
_REMEDIES = {
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "free some space or choose another disk",
    errno.EACCES: "check the permissions or choose another folder",
    errno.EPERM: "check the permissions or choose another folder",
    errno.EROFS: "choose another folder",
    errno.ENOENT: "check the name",
}


def run(name: str, command: click.Command, arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code, having told what went wrong in one line on stderr.

    Parameters
    ----------
    name : str
        Of the command line, such as "rig-session"; begins the line.
    command : click.Command
        Returns an exit code, or None for 0.
    arguments : sequence of str, optional
        Default: those of this process.

    Returns
    -------
    int
        The `exit_code` of the project's own errors, 2 for wrong usage and what the system refuses, 130 when
        interrupted, 1 for a fault in this software (its traceback is shown when RIG_TRACEBACK is set).
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks a sign gets a question mark
            stream.reconfigure(errors="replace")
    try:
        outcome = command.main(args=arguments, prog_name=name, standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        return _tell(name, "interrupted", INTERRUPTED)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0
    except Exception as error:  # the last resort: no traceback reaches a user
        if os.environ.get("RIG_TRACEBACK"):
            raise
        return _tell(name, *_explained(error))
    return outcome if isinstance(outcome, int) else 0


def leave(exit_code: int) -> NoReturn:
    """End the program, at once where a thread was left behind.

    One that hangs in a driver would come back from it while the interpreter is taken down, and abort the program.
    """
    if any(thread.daemon for thread in threading.enumerate()):
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):  # nobody reads it any more
                stream.flush()
        os._exit(exit_code)
    sys.exit(exit_code)


def _explained(error: Exception) -> tuple[str, int]:
    exit_code = getattr(error, "exit_code", None)
    if isinstance(exit_code, int):
        remedy = getattr(error, "remedy", "")
        return f"{error}{': ' + remedy if remedy else ''}", exit_code
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        remedy = _REMEDIES.get(error.errno or 0)
        return f"{where}{reason(error)}{': ' + remedy if remedy else ''}", _CONFIGURATION
    return (
        f"a fault in this software: {type(error).__name__}: {reason(error)}; set RIG_TRACEBACK=1 to see where",
        _FAULT,
    )


def _tell(name: str, message: str, exit_code: int) -> int:
    line = f"{name}: {message}"
    if sys.stderr.isatty():
        line = wrapped(line, shutil.get_terminal_size().columns)
    with suppress(OSError):  # the terminal is gone, the exit code still tells
        print(line, file=sys.stderr)  # noqa: T201 - this is the command line
    return exit_code


def wrapped(line: str, width: int) -> str:
    """Break a line between words; a command that it names stays whole, so that it can be copied."""
    lines = [""]
    for word in _WORDS.findall(line):
        longer = f"{lines[-1]} {word}".lstrip()
        if len(longer) < width or not lines[-1]:
            lines[-1] = longer
        else:
            lines.append(word)
    return "\n".join(lines)
