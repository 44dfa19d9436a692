"""What makes a pose count: the board still all the while, and where it has not been before."""

from dataclasses import replace

import numpy as np
import pytest
from capturing import captured, small_rig

from acquire import capture, errors
from acquire.devices.base import Frame, Rig
from rigs.session.reader import Session


@pytest.fixture
def changed_rig(monkeypatch):
    """Return a function that changes the simulated rig before it is captured with."""
    choose_devices = capture.choose_devices

    def change(change_rig):
        monkeypatch.setattr(capture, "choose_devices", lambda *args, **keys: change_rig(choose_devices(*args, **keys)))

    return change


class NudgedCamera:
    """A camera whose pictures are shifted while it is told so."""

    def __init__(self, camera, is_nudged) -> None:
        self._camera, self._is_nudged = camera, is_nudged
        self.warnings: list[str] = []
        self.open, self.close, self.collect = camera.open, camera.close, camera.collect

    def read(self) -> Frame:
        return self._nudged(self._camera.read())

    def collected(self) -> list[Frame]:
        return [self._nudged(frame) for frame in self._camera.collected()]

    def _nudged(self, frame: Frame) -> Frame:
        return replace(frame, image=np.roll(frame.image, 4, axis=1)) if self._is_nudged() else frame


def test_a_board_that_was_moved_and_put_back_does_not_count(tmp_path, changed_rig, monkeypatch):
    def nudged_after_the_first_buzzer_only(rig: Rig) -> Rig:
        played, play = [], rig.trigger.play
        monkeypatch.setattr(rig.trigger, "play", lambda *what: (played.append(what), play(*what))[1])
        return replace(rig, camera=NudgedCamera(rig.camera, lambda: len(played) == 1))

    changed_rig(nudged_after_the_first_buzzer_only)
    heard = captured(tmp_path / "s.h5", small_rig(capture={"poses": 1}))
    assert "pose 1 of 1: the board moved by 4.0 px while the buzzers sounded" in heard.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].tolist() == [0, 1]


class ForgetfulOperator:
    """Somebody who comes back to places where the board has been."""

    def __init__(self, operator, places: list[int]) -> None:
        self._operator, self._places = operator, places

    def ask_for_pose(self, pose: int) -> None:
        self._operator.ask_for_pose(self._places[pose])


def test_a_place_that_was_captured_before_the_last_is_not_captured_again(tmp_path, changed_rig):
    changed_rig(lambda rig: replace(rig, operator=ForgetfulOperator(rig.operator, [0, 1, 0])))
    found = small_rig(capture={"poses": 3, "pose_timeout_s": 4})
    with pytest.raises(errors.CaptureQualityError, match="where it was before: move the board to a place"):
        captured(tmp_path / "s.h5", found)
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].tolist() == [1, 1]


def test_five_frames_are_stored_each_second_from_before_the_first_buzzer_to_after_the_last(tmp_path):
    found = small_rig(capture={"poses": 1, "frame_interval_s": 0.2}, signal={"repeats": 4})
    captured(tmp_path / "s.h5", found)
    with Session.open(tmp_path / "s.h5") as session:
        times_s, emissions_s = session.frames["host_time_s"], session.emissions["host_time_s"]
    assert times_s[0] < emissions_s.min()
    assert times_s[-1] > emissions_s.max() + 0.1
    assert np.diff(times_s)[:-1] == pytest.approx(0.2, abs=0.01)
