"""A result read back from its YAML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from calib.errors import ResultFileError
from calib.result import FORMAT, VERSION

FloatArray = NDArray[np.float64]

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class ArrayResult:
    """What a result says of the array.

    Parameters
    ----------
    name : str
        Of the file.
    channels : tuple of int
    positions_m : (n_mics, 3) array
        Camera frame.
    covariance_m2 : (3 n_mics, 3 n_mics) array
        Of all positions together, microphone by microphone.
    sessions : frozenset of str
        SHA-256 of the sessions that it rests on.
    """

    name: str
    channels: tuple[int, ...]
    positions_m: FloatArray
    covariance_m2: FloatArray
    sessions: frozenset[str]

    def only(self, channels: tuple[int, ...]) -> ArrayResult:
        """Return the result of some channels, in their order."""
        rows = np.array([self.channels.index(channel) for channel in channels], dtype=np.intp)
        places = (3 * rows[:, None] + np.arange(3)).ravel()
        return ArrayResult(
            self.name, channels, self.positions_m[rows], self.covariance_m2[np.ix_(places, places)], self.sessions
        )


def read_result(path: Path) -> ArrayResult:
    """Read a result's file.

    Raises
    ------
    ResultFileError
        Missing, no result, or of a version without the covariance of the whole array.
    """
    document = _document(path)
    try:
        microphones = document["microphones"]
        channels = tuple(int(microphone["channel"]) for microphone in microphones)
        positions_m = np.array([microphone["position_m"] for microphone in microphones], dtype=float)
        covariance_m2 = np.array(document["array_covariance_m2"], dtype=float)
        sessions = document["sessions"] if "sessions" in document else [document["session"]]
        read = ArrayResult(
            path.name, channels, positions_m, covariance_m2, frozenset(str(each["sha256"]) for each in sessions)
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ResultFileError(
            f"{path}: lacks {error if isinstance(error, KeyError) else 'a part, or has a bad one'}: an earlier version "
            "made it, or a hand changed it; calibrate its session again"
        ) from error
    _check(read, path)
    return read


def _document(path: Path) -> dict[str, Any]:
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), Loader=_LOADER)  # noqa: S506 - a safe loader
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be read ({error.strerror}): name a result of rig-calibrate") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ResultFileError(f"{path}: no result, or a damaged one: name a result of rig-calibrate") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ResultFileError(f"{path}: no result: name a file that rig-calibrate wrote (SESSION.calib.yaml)")
    if document.get("version") != VERSION:
        raise ResultFileError(f"{path}: of version {document.get('version')}, this software reads {VERSION}")
    return document


def _check(read: ArrayResult, path: Path) -> None:
    n_mics = len(read.channels)
    whole = read.positions_m.shape == (n_mics, 3) and read.covariance_m2.shape == (3 * n_mics, 3 * n_mics)
    whole = whole and bool(np.isfinite(read.positions_m).all() and np.isfinite(read.covariance_m2).all())
    if not whole or len(set(read.channels)) < n_mics or (np.diag(read.covariance_m2) <= 0).any():
        raise ResultFileError(f"{path}: its numbers contradict one another: calibrate its session again")
