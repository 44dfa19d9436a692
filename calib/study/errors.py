"""The errors of studies; every message says what is wrong, where, and what to do."""

from calib.errors import CalibrationError


class StudyError(CalibrationError):
    """The study asked for cannot be run: wrong usage, or something that it needs is not there."""

    exit_code = 2


class FolderError(StudyError):
    """The result folder holds another study, or cannot be used."""


class DiskError(CalibrationError):
    """Results cannot be written; what was finished stays."""

    exit_code = 3


class EndedError(CalibrationError):
    """Somebody ended the computation (Ctrl-C, SIGTERM); what was finished stays."""

    exit_code = 130


class ClusterError(CalibrationError):
    """The cluster is not there, or died; what was finished stays."""

    exit_code = 3
