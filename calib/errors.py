"""The errors of calibration; every message says what is wrong, where, and what to do."""


class CalibrationError(Exception):
    """Base of all errors of the `calib` package; `exit_code` is what the command line returns for it."""

    exit_code = 5


class MethodError(CalibrationError):
    """The method asked for does not fit the rig or the session."""

    exit_code = 2


class ResultFileError(CalibrationError):
    """A file that should be a result is none, or is of another version."""

    exit_code = 2


class NotEnoughDataError(CalibrationError):
    """The session does not hold enough good measurements for an answer."""


class NotConvergedError(CalibrationError):
    """The solver found no answer."""
