"""The frames of a pose: in their rhythm, and counted where they are missing."""

from types import SimpleNamespace

import numpy as np
import pytest
from capturing import captured, small_rig

from acquire import capture
from acquire.devices.base import Frame, Rhythm
from acquire.devices.frame_queue import FrameQueue
from acquire.errors import DeviceError
from acquire.film import Film
from rigs.session.reader import Session


def frame(time_s: float) -> Frame:
    return Frame(np.zeros((10, 10), np.uint8), time_s)


def collected(times_s, interval_s: float = 0.2, **options) -> list[Frame]:
    queue = FrameQueue(Rhythm(100.0, interval_s), **options)
    for time_s in times_s:
        if queue.is_due(time_s):
            queue.put(frame(time_s))
    return queue.take()


@pytest.mark.parametrize("fps", [30.0, 12.5, 10.0, 5.0])
def test_one_frame_is_held_per_interval_and_none_is_missing(fps):
    jitter_s = np.random.default_rng(1).uniform(0, 0.02, 200)
    held = collected(100 + np.arange(1, 200) / fps + jitter_s[1:])
    assert len(held) in (int(199 / fps / 0.2) - 1, int(199 / fps / 0.2), int(199 / fps / 0.2) + 1)
    assert not any(each.n_missing for each in held)
    assert held[-1].host_time_s - held[0].host_time_s == pytest.approx(0.2 * (len(held) - 1), abs=0.15)


def test_a_camera_that_is_too_slow_misses_frames_at_its_own_rate():
    held = collected(100 + np.arange(1, 41) / 4.0)
    assert len(held) == 40
    assert sum(each.n_missing for each in held) == pytest.approx(10, abs=1)


def test_a_pause_is_counted_in_the_frame_after_it():
    held = collected([100.2, 100.4, 101.4, 101.6])
    assert [each.n_missing for each in held] == [0, 0, 4, 0]


def test_frames_that_find_no_room_are_counted_and_those_that_wait_are_kept():
    queue = FrameQueue(Rhythm(100.0, 0.2), most_bytes=300)
    for number in range(1, 8):
        queue.put(frame(100 + 0.2 * number))
    assert [each.host_time_s for each in queue.take()] == pytest.approx([100.2, 100.4, 100.6])
    queue.put(frame(101.6))
    assert [each.n_missing for each in queue.take()] == [4]


def test_frames_that_never_come_before_the_end_are_counted():
    queue = FrameQueue(Rhythm(100.0, 0.2), most_bytes=300)
    for number in range(1, 6):
        queue.put(frame(100 + 0.2 * number))
    assert queue.n_missing_at(101.1) == 2  # of which was no room for
    assert queue.n_missing_at(101.9) == 5


@pytest.mark.parametrize("is_lost", [False, True])
def test_what_the_camera_still_holds_at_the_end_is_stored_and_its_loss_is_left_to_others(is_lost):
    def collected():
        if is_lost:
            raise DeviceError("camera: gone")
        return [frame(100.2)]

    stored = []
    camera = SimpleNamespace(collect=lambda rhythm: 3 if rhythm is None else 0, collected=collected)
    writer = SimpleNamespace(append_frame=lambda _image, **keys: stored.append(keys["host_time_s"]))
    film = Film(camera, writer, small_rig().description)
    film.begin(frame(100.0), 0)
    between = film.end()
    assert stored == ([100.0] if is_lost else [100.0, 100.2])
    assert len(between) == len(stored) - 1
    assert film.n_missing == 3


class StutteringCamera:
    """A camera that sends nothing for some time in every emission."""

    def __init__(self, camera) -> None:
        self.warnings: list[str] = []
        self.open, self.close, self.read, self.collect = camera.open, camera.close, camera.read, camera.collect
        self._camera, self._n_calls = camera, 0

    def collected(self) -> list[Frame]:
        frames = self._camera.collected()
        self._n_calls += 1
        return [Frame(each.image, each.host_time_s, n_missing=2 * (self._n_calls < 4)) for each in frames]


def test_missing_frames_are_warned_of_once_per_pose_and_counted_at_the_end(tmp_path, monkeypatch):
    choose_devices = capture.choose_devices

    def with_stutter(*args, **keys):
        rig = choose_devices(*args, **keys)
        return type(rig)(rig.trigger, rig.audio, StutteringCamera(rig.camera), rig.clock, rig.operator, rig.truth)

    monkeypatch.setattr(capture, "choose_devices", with_stutter)
    listener = captured(tmp_path / "s.h5", small_rig(capture={"poses": 2}))
    assert listener.warnings().count("of its frames are missing") == 1
    with Session.open(tmp_path / "s.h5") as session:
        lines = [text.decode() for text in session.log["text"]]
        n_missing = next(line.split(": ")[1].split(" ")[0] for line in lines if "of its frames are missing" in line)
        assert f"{len(session.frames)} frames stored, {n_missing} missing" in lines


def test_a_camera_that_sends_nothing_all_the_pose_is_warned_of(tmp_path, monkeypatch):
    monkeypatch.setattr(FrameQueue, "is_due", lambda *_: False)
    listener = captured(tmp_path / "s.h5", poses=1)
    with Session.open(tmp_path / "s.h5") as session:
        (pose,), n_frames = session.poses, len(session.frames)
    n_intervals = round((pose["end_host_time_s"] - pose["start_host_time_s"]) / 0.1)
    n_missing = int(listener.warnings().split(" of its frames are missing")[0].split()[-1])
    assert n_frames == 2
    assert n_missing == pytest.approx(n_intervals, abs=3)


def test_no_missing_frame_is_said_at_the_end(tmp_path):
    captured(tmp_path / "s.h5")
    with Session.open(tmp_path / "s.h5") as session:
        assert f"{len(session.frames)} frames stored, none missing".encode() in session.log["text"].tolist()
