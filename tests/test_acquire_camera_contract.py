"""What every camera must do, whether simulated, in the network or recorded."""

import time
from contextlib import ExitStack
from itertools import count

import cv2
import numpy as np
import pytest
from simulated import make_description
from virtual_bench.mjpeg import mjpeg_server

from acquire.clock import MonotonicClock
from acquire.devices.base import Rhythm
from acquire.devices.camera_opencv import OpenCvCamera
from acquire.devices.choose import choose_devices
from acquire.errors import DeviceError

SIZE_PX = (320, 240)
FPS = 25.0


def noisy_picture(number: int) -> np.ndarray:
    """Return a colour picture of which no two are the same."""
    noise = np.random.default_rng(number).integers(0, 40, (SIZE_PX[1], SIZE_PX[0], 3), dtype=np.uint8)
    return noise + np.array([20, 60, 120], np.uint8)


def jpegs():
    number = count()
    return lambda _: cv2.imencode(".jpg", noisy_picture(next(number)))[1].tobytes()


def opencv_camera(source: object, **changes: object) -> OpenCvCamera:
    camera = {"driver": "opencv", "source": source, "size_px": SIZE_PX, "fps": FPS} | changes
    return OpenCvCamera(make_description(camera=camera).camera)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    for number in range(200):
        cv2.imwrite(str(folder / f"{number:03d}.png"), noisy_picture(number))
    return folder


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "session.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), FPS, SIZE_PX)
    for number in range(200):
        writer.write(noisy_picture(number))
    writer.release()
    return path


@pytest.fixture
def server():
    with mjpeg_server(jpegs(), FPS) as server:
        yield server


@pytest.fixture(params=["simulated", "network", "folder", "video"])
def camera_and_clock(request):
    """Return a camera, not yet opened, and the clock that its host times are of."""
    with ExitStack() as stack:
        if request.param == "simulated":
            rig = choose_devices(make_description(camera={"size_px": SIZE_PX, "fps": FPS}))
            camera, clock = rig.camera, rig.clock
        elif request.param == "network":
            camera, clock = opencv_camera(request.getfixturevalue("server").url), MonotonicClock()
        else:
            camera, clock = opencv_camera(str(request.getfixturevalue(request.param))), MonotonicClock()
        stack.callback(camera.close)
        yield camera, clock


@pytest.fixture
def opened(camera_and_clock):
    camera, clock = camera_and_clock
    camera.open()
    return camera, clock


def test_it_names_its_driver_and_version(camera_and_clock):
    camera, _ = camera_and_clock
    name, version, *_ = camera.open().split(" ")
    assert name
    assert version[0].isdecimal()


def test_a_frame_is_never_older_than_the_question_for_it(opened):
    camera, clock = opened
    for pause_s in (0.0, 0.3, 0.0, 0.1, 0.0):
        clock.sleep_s(pause_s)
        asked_s = clock.now_s()
        frame = camera.read()
        assert asked_s < frame.host_time_s <= clock.now_s() + 0.01


def test_frames_come_one_after_the_other_each_with_its_time(opened):
    camera, _ = opened
    frames = [camera.read() for _ in range(6)]
    assert (np.diff([frame.host_time_s for frame in frames]) > 0).all()
    assert len({frame.image.tobytes() for frame in frames}) == 6


def test_frames_are_bytes_of_the_size_in_the_description(opened):
    image = opened[0].read().image
    assert image.shape[:2] == (SIZE_PX[1], SIZE_PX[0])
    assert image.dtype == np.uint8


def check_rhythm(frames, since_s, interval_s):
    """Every interval has its frame, or is counted as missing."""
    times_s = np.array([since_s, *(frame.host_time_s for frame in frames)])
    n_intervals = len(frames) + sum(frame.n_missing for frame in frames)
    assert n_intervals == pytest.approx((times_s[-1] - since_s) / interval_s, abs=1)
    assert (np.diff(times_s) > 0).all()


def test_frames_are_collected_in_a_rhythm_while_nobody_has_time_for_them(opened):
    camera, clock = opened
    first = camera.read()
    camera.collect(Rhythm(first.host_time_s, 0.2))
    clock.sleep_s(1.0)
    frames = camera.collected()
    assert len(frames) >= 3
    clock.sleep_s(0.5)
    frames += camera.collected()
    check_rhythm(frames, first.host_time_s, 0.2)
    assert len({frame.image.tobytes() for frame in (first, *frames)}) == len(frames) + 1
    assert camera.collected() == []


def test_reading_takes_nothing_from_what_is_collected(opened):
    camera, _ = opened
    first = camera.read()
    camera.collect(Rhythm(first.host_time_s, 0.1))
    last_s = [camera.read().host_time_s for _ in range(15)][-1]
    frames = camera.collected()
    check_rhythm(frames, first.host_time_s, 0.1)
    assert last_s - frames[-1].host_time_s < 0.2


def test_no_more_is_collected_than_was_asked_for(opened):
    camera, clock = opened
    clock.sleep_s(0.3)
    assert camera.collected() == []
    camera.collect(Rhythm(clock.now_s(), 0.1))
    clock.sleep_s(0.3)
    camera.collect(None)
    clock.sleep_s(0.3)
    assert camera.collected() == []


def test_collecting_goes_on_after_it_was_closed_and_opened_again(opened):
    camera, clock = opened
    camera.collect(Rhythm(clock.now_s(), 0.1))
    camera.close()
    camera.collected()
    assert camera.collected() == []
    clock.sleep_s(0.5)
    camera.open()
    camera.read()
    clock.sleep_s(0.3)
    frames = camera.collected()
    assert frames[0].n_missing >= 4
    assert len(frames) >= 2


def test_it_can_be_closed_twice_and_opened_again(camera_and_clock):
    camera, _ = camera_and_clock
    camera.close()
    for _ in range(2):
        camera.open()
        first = camera.read()
        camera.close()
        camera.close()
        assert first.image.any()


def test_one_that_is_not_open_says_so(camera_and_clock):
    camera, _ = camera_and_clock
    camera.open()
    camera.close()
    with pytest.raises(DeviceError, match="not open; open it first"):
        camera.read()


def read_on(camera):
    for _ in range(250):
        camera.read()


def collect_on(camera):
    camera.collect(Rhythm(0.0, 0.2))
    for _ in range(250):
        camera.collected()
        time.sleep(0.02)


def lose_simulated():
    rig = choose_devices(
        make_description(camera={"size_px": SIZE_PX}, simulation={"faults": [{"kind": "camera_lost", "pose": 1}]})
    )
    return rig.camera, lambda: rig.operator.ask_for_pose(1)


@pytest.mark.parametrize("go_on", [read_on, collect_on])
@pytest.mark.parametrize("fault", ["simulated", "dropped", "stalled", "ended"])
def test_a_lost_camera_is_told_in_time(fault, go_on, server, tmp_path):
    if fault == "simulated":
        camera, lose = lose_simulated()
    elif fault == "ended":
        for number in range(8):
            cv2.imwrite(str(tmp_path / f"{number}.png"), noisy_picture(number))
        camera, lose = opencv_camera(str(tmp_path)), lambda: None
    else:
        camera, lose = opencv_camera(server.url), {"dropped": server.drop, "stalled": server.stall}[fault]
    camera.open()
    camera.read()
    lose()
    lost_s = time.monotonic()
    with pytest.raises(DeviceError, match=r"check its cable|give a longer recording"):
        go_on(camera)
    assert time.monotonic() - lost_s < 10
    camera.close()


def test_a_network_camera_that_freezes_is_told_and_goes_on_when_it_thaws(server):
    camera = opencv_camera(server.url)
    camera.open()
    server.freeze()
    with pytest.raises(DeviceError, match=r"frozen, it has sent the same picture for 1 s: take the cap off"):
        read_on(camera)
    server.come_back()
    for _ in range(200):
        try:
            assert camera.read().image.any()
            break
        except DeviceError:
            time.sleep(0.02)
    assert camera.read().image.any()
    camera.close()


def test_a_network_camera_that_was_dropped_can_be_opened_again_when_it_is_back(server):
    camera = opencv_camera(server.url)
    camera.open()
    server.drop()
    with pytest.raises(DeviceError):
        read_on(camera)
    camera.close()
    with pytest.raises(DeviceError, match="no stream from this address"):
        camera.open()
    server.come_back()
    camera.open()
    assert camera.read().image.any()
    camera.close()
