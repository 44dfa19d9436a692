"""The camera over OpenCV: what it refuses, what it tells, and what it must never do."""

import os
import socket
import subprocess
import sys
import time
from itertools import count
from threading import Event, Thread

import cv2
import numpy as np
import pytest
from capturing import Listener, small_rig
from simulated import make_description
from virtual_bench.mjpeg import mjpeg_server

from acquire.capture import capture
from acquire.devices.camera_lock import lock_controls
from acquire.devices.camera_opencv import OpenCvCamera
from acquire.devices.camera_source import SourceKind, camera_source
from acquire.devices.jpeg_complaints import no_jpeg_complaints
from acquire.errors import DeviceError
from rigs.description import Exposure
from rigs.session.reader import Session

LOCKED_ELSEWHERE = "cannot be locked over the network"


def opencv_camera(source: object, **changes: object) -> OpenCvCamera:
    camera = {"driver": "opencv", "source": source, "size_px": (64, 64), "fps": 50, **changes}
    return OpenCvCamera(make_description(camera=camera).camera)


def picture(number: int, size_px: tuple[int, int] = (64, 64)) -> np.ndarray:
    return np.full((size_px[1], size_px[0], 3), (number % 25) * 10, np.uint8)


def jpeg(image: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", image)[1].tobytes()


def play(camera: OpenCvCamera, seen: list[int]) -> None:
    """Note the brightness of every picture until there are no more."""
    while True:
        seen.append(round(camera.read().image.mean() / 10))


@pytest.fixture
def silent_port():
    """Return a port where somebody listens and never says a word."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


@pytest.mark.parametrize(
    ("named", "kind", "label"),
    [
        (0, SourceKind.DEVICE, "camera 0"),
        ("2", SourceKind.DEVICE, "camera 2"),
        ("/dev/v4l/by-id/usb-cam", SourceKind.DEVICE, "/dev/v4l/by-id/usb-cam"),
        ("rtsp://me:se:cr@t@cam:554/live?token=secret", SourceKind.ADDRESS, "rtsp://cam:554/live"),
        ("http://cam/video?user=me&pwd=secret", SourceKind.ADDRESS, "http://cam/video"),
        ("session.avi", SourceKind.FILE, "session.avi"),
        (".", SourceKind.FOLDER, "."),
    ],
)
def test_a_source_is_what_its_form_says_and_its_label_keeps_secrets(named, kind, label):
    source = camera_source(named)
    assert (source.kind, source.label) == (kind, label)
    assert source.is_live == (kind in (SourceKind.DEVICE, SourceKind.ADDRESS))


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("/dev/video97", "/dev/video97: there is no such camera: check its cable, and camera.source"),
        (97, "/dev/video97: there is no such camera"),
        ("/nowhere/session.avi", "/nowhere/session.avi: there is no such file or folder"),
        ("/dev/null", "/dev/null: no camera there, or another program uses it"),
        (__file__, r"not a video that OpenCV can read: try another format"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="paths of Linux")
def test_what_is_not_there_is_said_in_one_line(source, message):
    with pytest.raises(DeviceError, match=message) as caught:
        opencv_camera(source).open()
    assert "\n" not in str(caught.value)


def test_a_folder_without_pictures_and_one_with_a_broken_picture_are_named(tmp_path):
    (tmp_path / "notes.txt").write_text("no picture")
    with pytest.raises(DeviceError, match="no pictures in this folder"):
        opencv_camera(str(tmp_path)).open()
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(DeviceError, match=r"a\.png: not a picture that OpenCV can read"):
        opencv_camera(str(tmp_path)).open()


def test_a_folder_that_is_gone_is_one_line_and_no_traceback(tmp_path):
    camera = opencv_camera(str(tmp_path / "pictures"))
    (tmp_path / "gone").mkdir()
    gone = opencv_camera(str(tmp_path / "gone"))
    (tmp_path / "gone").rmdir()
    for each, why in ((gone, "cannot be read .No such file"), (camera, "there is no such file or folder")):
        with pytest.raises(DeviceError, match=why):
            each.open()


def test_another_size_is_refused_with_both_sizes():
    with mjpeg_server(lambda _: jpeg(picture(3, (96, 80)))) as server:
        camera = opencv_camera(server.url)
        with pytest.raises(DeviceError, match=r"sends pictures of 96 x 80 pixels, camera.size_px wants 64 x 64"):
            camera.open()
        with pytest.raises(DeviceError, match="open it first"):
            camera.read()


def test_a_silent_host_neither_hangs_the_program_nor_shows_the_password(silent_port, capfd):
    camera = opencv_camera(f"rtsp://me:secret@127.0.0.1:{silent_port}/live")
    with pytest.raises(DeviceError, match=f"rtsp://127.0.0.1:{silent_port}/live: no stream from this address") as e:
        camera.open()
    shown = capfd.readouterr()
    assert "secret" not in str(e.value) + str(e.value.__cause__) + shown.out + shown.err


def test_the_libraries_write_nothing_on_the_screen(tmp_path):
    """In a program of its own, since the libraries read their settings once."""
    program = f"""
import sys
sys.path.insert(0, {str(__file__).rsplit("/", 1)[0]!r})
from test_acquire_camera_opencv import opencv_camera
for source in ("http://me:secret@127.0.0.1:1/x", "/dev/null", {str(tmp_path / "broken.avi")!r}):
    try:
        opencv_camera(source).open()
    except Exception as error:
        print(error)
"""
    (tmp_path / "broken.avi").write_bytes(b"RIFF\0\0\0\0AVI LIST" + bytes(1000))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr == ""
    assert len(done.stdout.splitlines()) == 3


def test_a_damaged_jpeg_is_decoded_without_a_word_on_the_screen(tmp_path, capfd):
    image = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    damaged = jpeg(image)[:-2] + b"\0\1\2" * 20 + b"\xff\xd9"
    cv2.imdecode(np.frombuffer(damaged, np.uint8), cv2.IMREAD_COLOR)
    assert "Corrupt JPEG data" in capfd.readouterr().err, "the picture is not damaged enough"
    for number in range(3):
        (tmp_path / f"{number}.jpg").write_bytes(damaged)
    camera = opencv_camera(str(tmp_path))
    camera.open()
    assert camera.read().image.shape == image.shape
    camera.close()
    assert capfd.readouterr().err == ""


def say_and_fail():
    os.write(2, b"and the house")
    raise DeviceError("the sensor melts")


def test_other_words_on_standard_error_are_not_lost(capfd):
    with no_jpeg_complaints():
        os.write(2, b"Corrupt JPEG data: 58 extraneous bytes before marker 0xd9\nthe disk is on fire\n")
        assert capfd.readouterr().err == ""
    assert capfd.readouterr().err == "the disk is on fire\n"
    with pytest.raises(DeviceError), no_jpeg_complaints():
        say_and_fail()
    assert capfd.readouterr().err == "and the house"


def test_two_cameras_do_not_keep_standard_error_from_each_other(capfd):
    entered, may_end = Event(), Event()

    def another():
        with no_jpeg_complaints():
            entered.set()
            may_end.wait(60)

    thread = Thread(target=another)
    with no_jpeg_complaints():
        thread.start()
        entered.wait(0.3)  # in vain: one at a time
    may_end.set()
    thread.join(60)
    os.write(2, b"still there\n")
    assert capfd.readouterr().err == "still there\n"


def test_what_was_stored_up_while_nobody_read_is_never_handed_over():
    number = count()
    shown = []

    def next_jpeg(_: float) -> bytes:
        shown.append(next(number) % 25)
        return jpeg(picture(shown[-1]))

    with mjpeg_server(next_jpeg, fps=50) as server:
        camera = opencv_camera(server.url)
        camera.open()
        for _ in range(3):
            time.sleep(0.3)
            newest = len(shown)
            seen = round(camera.read().image.mean() / 10)
            assert seen in shown[newest - 1 :]
            assert camera.n_grabbed >= newest - 2
        camera.close()


def test_colour_stays_colour_and_gray_stays_gray(tmp_path):
    for kind, image in (("colour", picture(3)), ("gray", picture(3)[..., 0])):
        (tmp_path / kind).mkdir()
        for number in range(40):
            cv2.imwrite(str(tmp_path / kind / f"{number:02d}.png"), image)
        camera = opencv_camera(str(tmp_path / kind))
        camera.open()
        assert np.array_equal(camera.read().image, image)
        camera.close()


def test_a_folder_is_played_in_the_order_of_names_and_may_repeat_itself(tmp_path):
    for number in range(12):
        cv2.imwrite(str(tmp_path / f"{number:02d}.png"), picture(number // 10))
    camera = opencv_camera(str(tmp_path), fps=5)
    assert camera.open() == f"opencv {cv2.__version__}, {tmp_path}, 64 x 64 at 5 pictures/s"
    seen: list[int] = []
    with pytest.raises(DeviceError, match="played to its end: give a longer recording, or a camera"):
        play(camera, seen)
    camera.close()
    assert seen == sorted(seen)
    assert set(seen) == {0, 1}


def test_a_slow_camera_and_one_that_cannot_be_locked_are_warned_of():
    number = count()
    with mjpeg_server(lambda _: jpeg(picture(next(number))), fps=10) as server:
        camera = opencv_camera(server.url)
        camera.open()
        camera.close()
    locked, slow = camera.warnings
    assert LOCKED_ELSEWHERE in locked
    assert "pictures/s although camera.fps wants 50: give it more light" in slow


def test_what_the_driver_refuses_is_told_and_logged(tmp_path):
    """A capture says and stores it; this one ends when the pictures do."""
    number = count()
    with mjpeg_server(lambda _: jpeg(picture(next(number)))) as server:
        camera = {"driver": "opencv", "source": server.url, "size_px": (64, 64), "fps": 30}
        found, listener = small_rig(camera=camera, capture={"device_wait_s": 1}), Listener()
        with pytest.raises(DeviceError, match="the camera did not come back within 1 s"):
            capture(found, tmp_path / "s.h5", screen=DroppingScreen(listener, server.drop))
    assert LOCKED_ELSEWHERE in listener.warnings()
    assert "no more pictures" in listener.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert any(LOCKED_ELSEWHERE in str(line) for line in session.log)
        assert f"opencv-ffmpeg {cv2.__version__}, {server.url}, 64 x 64 at" in session.versions["camera"]


class DroppingScreen:
    """A screen that pulls the camera's plug when it is shown something."""

    def __init__(self, listener: Listener, drop) -> None:
        self.say, self._show, self._drop = listener.say, listener.show, drop

    def show(self, status) -> None:
        self._show(status)
        self._drop()


class ScriptedControls:
    """A driver's properties, of which some do not do what they are told."""

    def __init__(self, values: dict[int, float], stuck: tuple[int, ...] = (), only: dict[int, float] | None = None):
        self.values, self.stuck, self.only = values, stuck, only or {}

    def get(self, prop: int) -> float:
        return self.values.get(prop, -1.0)

    def set(self, prop: int, value: float) -> bool:
        taken = prop in self.values and prop not in self.stuck and self.only.get(prop, value) == value
        if taken:
            self.values[prop] = value
        return True  # they all say so


AUTO, FOCUS_AUTO, EXPOSURE, FOCUS = (
    cv2.CAP_PROP_AUTO_EXPOSURE,
    cv2.CAP_PROP_AUTOFOCUS,
    cv2.CAP_PROP_EXPOSURE,
    cv2.CAP_PROP_FOCUS,
)


@pytest.mark.parametrize("manual", [1.0, 0.25])
def test_all_is_locked_and_set_whichever_number_means_manual(manual):
    controls = ScriptedControls({AUTO: 3.0, FOCUS_AUTO: 1.0, EXPOSURE: 10.0, FOCUS: 0.0}, only={AUTO: manual})
    assert lock_controls(controls, Exposure(exposure=150, focus=20)) == []
    assert controls.values == {AUTO: manual, FOCUS_AUTO: 0.0, EXPOSURE: 150.0, FOCUS: 20.0}


def test_what_cannot_be_locked_or_set_is_named():
    controls = ScriptedControls({AUTO: 3.0, FOCUS_AUTO: 1.0, EXPOSURE: 10.0}, stuck=(AUTO, FOCUS_AUTO, EXPOSURE))
    refusals = lock_controls(controls, Exposure(exposure=150, gain=4))
    assert [line.split(":")[0] for line in refusals] == [
        "automatic exposure stays on",
        "automatic focus stays on",
        "exposure is 10 although camera.exposure.exposure wants 150",
        "gain is -1 although camera.exposure.gain wants 4",
    ]


def test_nothing_is_touched_that_need_not_be_locked():
    controls = ScriptedControls({AUTO: 3.0, FOCUS_AUTO: 1.0})
    assert lock_controls(controls, Exposure(locked=False)) == []
    assert controls.values == {AUTO: 3.0, FOCUS_AUTO: 1.0}
