"""Pictures that waited on their way: which count as new, and that none has a time that is not its own."""

import time
from itertools import count

import cv2
import numpy as np
import pytest
from virtual_bench.mjpeg import mjpeg_server

from acquire.devices.camera_backlog import Backlog, Sleep
from acquire.devices.camera_stream import PictureStream
from acquire.errors import DeviceError

INTERVAL_S = 0.04
FPS = 10.0
STALL_S = 1.5


def judged(backlog, gaps_s, start_s=0.0, share=0.9):
    """Return what is said of pictures that come after such gaps, each slept through but for a tenth."""
    came_s = start_s + np.cumsum(gaps_s)
    return [
        backlog.is_new(float(at), share * gap if gap > 0.005 else 0.0) for at, gap in zip(came_s, gaps_s, strict=True)
    ]


def test_pictures_that_are_waited_for_are_new_after_what_was_stored_up_at_the_start():
    assert judged(Backlog(INTERVAL_S), [0.001] * 10 + [INTERVAL_S] * 5) == [False] * 11 + [True] * 4


@pytest.mark.parametrize("interval_s", [0.01, 0.04, 1.0, 5.0])
def test_the_true_interval_is_learnt(interval_s):
    assert all(judged(Backlog(INTERVAL_S), [interval_s] * 60)[4:])


def test_after_a_pause_neither_the_first_picture_nor_the_burst_counts():
    backlog = Backlog(INTERVAL_S)
    judged(backlog, [INTERVAL_S] * 50)
    assert judged(backlog, [1.0] + [0.001] * 24 + [INTERVAL_S] * 6, start_s=2.0)[:20] == [False] * 20
    assert all(judged(backlog, [INTERVAL_S] * 6, start_s=4.0)[2:])


def test_pictures_that_come_in_pairs_are_new():
    backlog = Backlog(INTERVAL_S)
    judged(backlog, [INTERVAL_S] * 50)
    assert all(judged(backlog, [2 * INTERVAL_S, 0.0] * 20, start_s=2.0)[2:])


def test_one_sleep_in_the_middle_of_a_burst_is_not_the_end_of_it():
    backlog = Backlog(INTERVAL_S)
    judged(backlog, [INTERVAL_S] * 50)
    assert not any(judged(backlog, [1.0] + [0.001] * 8 + [0.03] + [0.001] * 8, start_s=2.0))


def test_a_reader_that_never_waits_gets_no_new_picture_once_it_is_behind():
    backlog = Backlog(INTERVAL_S)
    judged(backlog, [INTERVAL_S] * 50)
    said = judged(backlog, [1.5 * INTERVAL_S] * 50, start_s=2.0, share=0.0)
    assert not any(said[3:])


def test_sleep_is_told_from_work():
    meter = Sleep()
    time.sleep(0.2)
    slept_s = meter.slept_s()
    assert slept_s > 0.05
    sum(range(3_000_000))
    assert meter.slept_s() < slept_s + 0.05 or not meter._knows_queue


class Busy:
    """Pictures for a host that is now and then too busy to fetch them."""

    def __init__(self, url: str) -> None:
        self._capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG)
        self.pause_s = 0.0
        self.grab, self.release = self._capture.grab, self._capture.release

    def retrieve(self):
        """Decode, after a pause if one is asked for."""
        time.sleep(self.pause_s)
        return self._capture.retrieve()


class Numbered:
    """A camera whose pictures tell when they were taken: each shows its number in bright and dark bars."""

    def __init__(self) -> None:
        self.taken_s: list[float] = []
        self._number = count()

    def next_jpeg(self, time_s: float) -> bytes:
        """Take a picture."""
        number = next(self._number)
        bars = [40 + 160 * (number >> bit & 1) for bit in range(10)]
        self.taken_s.append(time_s)
        image = np.repeat(np.repeat(np.array([bars], np.uint8), 16, axis=1), 64, axis=0)
        return cv2.imencode(".jpg", image)[1].tobytes()

    def age_s(self, frame) -> float:
        """Return how much older a frame is than its time says."""
        bars = frame.image.mean(axis=(0, 2)).reshape(10, 16).mean(axis=1) > 120
        return frame.host_time_s - self.taken_s[int(sum(1 << bit for bit in np.flatnonzero(bars)))]


@pytest.mark.parametrize("busy", ["network", "host"])
def test_after_a_stall_no_frame_is_older_than_two_intervals(busy):
    camera, opened = Numbered(), []
    with mjpeg_server(camera.next_jpeg, FPS) as server:
        stream = PictureStream(lambda: opened.append(Busy(server.url)) or opened[-1], "it", is_live=True, fps=FPS)
        ages_s = [camera.age_s(stream.next_frame(8.0)) for _ in range(8)]
        if busy == "network":
            server.hold()
        else:
            opened[0].pause_s = STALL_S
        n_before = len(camera.taken_s)
        while len(camera.taken_s) < n_before + STALL_S * FPS:
            time.sleep(0.05)
        opened[0].pause_s = 0.0
        server.come_back()
        ages_s += [camera.age_s(stream.next_frame(8.0)) for _ in range(12)]
        stream.stop()
    assert max(ages_s) < 2 / FPS


class Endless:
    """Pictures of which there is always one more at once, as fetching one takes longer than taking it."""

    work_s = 0.02

    def grab(self) -> bool:
        """Work for a while; wait for nothing."""
        end_s = time.thread_time() + self.work_s
        while time.thread_time() < end_s:
            pass
        return True

    def retrieve(self):
        """Return any picture."""
        return True, np.random.default_rng().integers(0, 255, (8, 8), dtype=np.uint8)

    def release(self) -> None:
        """Do nothing."""


def test_a_computer_that_is_too_slow_for_the_camera_says_so(monkeypatch):
    monkeypatch.setattr("acquire.devices.camera_stream._CATCH_UP_S", 1.0)
    stream = PictureStream(Endless, "it", is_live=True, fps=100.0)
    with pytest.raises(DeviceError, match=r"it: its pictures come late, .* too slow for so many: close other"):
        stream.next_frame(0.5)
    stream.stop()


class Slowing(Endless):
    """A camera that this computer keeps up with for some pictures, and then no longer."""

    work_s = 0.06  # well above the interval before, also where a busy computer wakes it late
    n_left = 20

    def grab(self) -> bool:
        """Wait for a new picture as long as there are some."""
        if not self.n_left:
            return super().grab()
        self.n_left -= 1
        time.sleep(0.02)
        return True


def test_pictures_may_come_late_for_a_while_whoever_asks(monkeypatch):
    monkeypatch.setattr("acquire.devices.camera_stream._CATCH_UP_S", 1.5)
    stream = PictureStream(Slowing, "it", is_live=True, fps=50.0)
    stream.next_frame(8.0)
    with pytest.raises(DeviceError, match=r"it: its pictures come late"):
        check_on(stream)
    assert time.monotonic() - stream._frame.host_time_s >= 1.5
    stream.stop()


def check_on(stream):
    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:
        stream.check(1.0)
        time.sleep(0.02)
