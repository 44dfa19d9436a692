"""The errors of what a rig is; every message says what is wrong, where, and what to do."""

import os
import re


class RigError(Exception):
    """Base of all errors of the `rigs` package.

    Attributes
    ----------
    exit_code : int
        What a command line returns for it (2: usage or configuration, 5: data not good enough).
    """

    exit_code = 2


class DescriptionError(RigError):
    """A rig description is missing, cannot be read, or says something impossible."""


class TargetError(RigError):
    """A file that would be written cannot be: not a file's name, or no such folder."""


class TargetExistsError(TargetError):
    """A file that would be written is already there; nothing is ever written over unasked."""


class SessionError(RigError):
    """A session file is missing, foreign, damaged, or lacks what is asked of it."""

    exit_code = 5


class DamagedSessionError(SessionError):
    """A session file is damaged, of which a part may still be good.

    Attributes
    ----------
    remedy : str
        What to do; ends the line that a command line shows.
    """

    remedy = "`rig-session recover FILE -o NEW.h5` copies what is good"


class SessionWriteError(SessionError):
    """The disk is full, or lost, while a session is written; what was flushed before is kept."""

    exit_code = 3


class ImportFormatError(RigError):
    """Published measurements that should be imported are missing or not of the known form."""

    exit_code = 5


def reason(error: BaseException) -> str:
    """Return in one short line why the system or a library refused, for use within a message."""
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    if number := re.search(r"errno = (\d+)", str(error)):  # HDF5 says it in its text only
        return os.strerror(int(number[1]))
    return " ".join(str(error).split())[:160] or type(error).__name__
