"""The network camera of the virtual bench, read by OpenCV."""

import time
from itertools import count

import cv2
import numpy as np
import pytest
from virtual_bench.mjpeg import mjpeg_server

BRIGHTNESS = 10


def numbered_jpegs():
    """Return a source of pictures of which each is brighter than the one before."""
    number = count(1)

    def next_jpeg(_: float) -> bytes:
        picture = np.full((48, 64, 3), BRIGHTNESS * (next(number) % 20), np.uint8)
        return cv2.imencode(".jpg", picture)[1].tobytes()

    return next_jpeg


@pytest.fixture
def server():
    with mjpeg_server(numbered_jpegs(), fps=50) as server:
        yield server


@pytest.fixture
def capture(server):
    capture = cv2.VideoCapture(server.url)
    yield capture
    capture.release()


def brightness(capture) -> int:
    good, picture = capture.read()
    assert good
    return round(picture.mean() / BRIGHTNESS)


def test_opencv_sees_every_picture_in_turn(capture):
    seen = [brightness(capture) for _ in range(6)]
    assert (np.diff(seen) % 20).tolist() == [1] * 5


def test_a_frozen_camera_repeats_itself_until_it_comes_back(server, capture):
    server.freeze()
    while brightness(capture) != brightness(capture):
        pass
    assert len({brightness(capture) for _ in range(5)}) == 1
    server.come_back()
    assert len({brightness(capture) for _ in range(20)}) > 5


def test_a_stalled_camera_sends_nothing(server, capture):
    server.stall()
    time.sleep(0.1)
    n_sent = len(server.sent_s)
    time.sleep(0.2)
    assert len(server.sent_s) == n_sent
    server.come_back()
    assert capture.grab()


def test_a_dropped_camera_ends_its_streams_and_takes_new_ones_when_it_is_back(server, capture):
    server.drop()
    while capture.grab():
        pass
    assert not cv2.VideoCapture(server.url).isOpened()
    server.come_back()
    again = cv2.VideoCapture(server.url)
    assert brightness(again) > 0
    again.release()
