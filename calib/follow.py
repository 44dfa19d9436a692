"""`rig-calibrate --follow`: a session is solved again with every pose that arrives, while it is being captured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.emissions import accepted_rows
from calib.errors import CalibrationError, MethodError, NotEnoughDataError
from calib.memory import Memory
from calib.pipeline import calibrate
from calib.progress import progress
from calib.result import Calibration
from calib.result_writer import check_result_target, write_calibration
from calib.settings import Settings
from calib.sound import Ear, windows_of
from rigs.errors import SessionError
from rigs.session.reader import Session
from rigs.session.watching import Growth, watch

PATIENCE = 10  # looks, for the sound of a pose that was saved already

Say = Callable[[dict[str, Any]], None]


def follow(path: Path, target: Path, settings: Settings, say: Say, *, overwrite: bool = False) -> Calibration | None:
    """Solve a growing session again and again, and write its result when it grows no more.

    Parameters
    ----------
    path : Path
        Of the session.
    target : Path
        Of the result.
    settings : Settings
    say : callable
        Gets one plain value per solve, as `progress` makes it.
    overwrite : bool
        An earlier result may be replaced.

    Returns
    -------
    The last result, of the session as a whole.

    Raises
    ------
    CalibrationError, SessionError, TargetError
        As of a session given at once.
    """
    if settings.method != "joint":
        raise MethodError(f"--follow solves by joint only: leave --method {settings.method} to the finished session")
    check_result_target(target, overwrite=overwrite)
    follower, result = Follower(settings, say), None
    for session, growth in watch(path):
        if growth is Growth.GROWING:
            follower.look(session)
        else:
            result = follower.finish(session, growth, target, overwrite=overwrite)
    return result


class Follower:
    """Solves as poses arrive.

    Parameters
    ----------
    settings : Settings
    say : callable
    """

    def __init__(self, settings: Settings, say: Say) -> None:
        self._settings, self._say = settings, say
        self._memory = Memory(Ear(settings.tdoa))
        self._n_poses = -1
        self._n_looks = 0

    def look(self, session: Session) -> None:
        """Solve, if there is a pose that was not there the last time."""
        n_poses = int(np.count_nonzero(session.poses["accepted"]))
        self._n_looks += 1
        if n_poses == self._n_poses or (not _is_heard_out(session) and self._n_looks < PATIENCE):
            return
        self._n_poses, self._n_looks = n_poses, 0
        settings = replace(self._settings, suggest_poses=max(self._settings.suggest_poses, 1))
        try:
            result = calibrate(session, settings, memory=self._memory)
        except MethodError:
            raise
        except (CalibrationError, SessionError) as error:
            self._say(progress("waiting", session, missing=str(error)))
        else:
            self._say(progress("solved", session, result))

    def finish(self, session: Session, growth: Growth, target: Path, *, overwrite: bool) -> Calibration:
        """Solve as if the session was given at once, write the result, and return it."""
        self._memory.is_over = True
        try:
            result = calibrate(session, self._settings, memory=self._memory)
        except (CalibrationError, SessionError) as error:
            self._say(progress(growth.value, session, missing=str(error)))
            raise
        write_calibration(result, target, overwrite=overwrite)
        self._say(progress(growth.value, session, result, target=target))
        return result


def _is_heard_out(session: Session) -> bool:
    """Tell whether the sound around every emission that counts is there: it is saved a little later than the pose."""
    try:
        windows = windows_of(session, accepted_rows(session), session.description.signal.waveform())
    except NotEnoughDataError:
        return True
    return session.tdoas is not None or bool((windows.held_samples() == windows.n_samples).all())
