"""What a capture does about each fault: go on, wait, or stop, with a line for the operator and a row in the log."""

import time
from collections import namedtuple
from dataclasses import replace
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from capturing import Listener, captured, small_rig, with_fault

from acquire import capture as capture_module
from acquire.clock import MonotonicClock
from acquire.errors import CaptureQualityError, DeviceError, DeviceLostError, DiskShortError, InterruptedCaptureError
from acquire.reconnection import Reconnection
from acquire.status import Status
from rigs.errors import SessionWriteError, TargetError
from rigs.session.layout import FLAG_GAP, FLAG_OVERFLOW
from rigs.session.reader import Session
from rigs.session.writer import SessionWriter

Usage = namedtuple("Usage", "total used free")


def log_lines(session):
    return "\n".join(text.decode() for text in session.log["text"])


def gaps(session):
    return np.flatnonzero(session.audio_blocks["flags"] & (FLAG_GAP | FLAG_OVERFLOW))


def median_late_s(session):
    """Return how late (s) each accepted emission is in the sound against its expected sample."""
    onsets = session.onsets[session.emissions["accepted"] == 1]
    return (onsets["measured_sample"] - onsets["predicted_sample"]) / session.sample_rate_hz


@pytest.mark.parametrize(
    ("kind", "name"),
    [("trigger_lost", "the trigger board"), ("camera_lost", "the camera"), ("audio_lost", "the sound device")],
)
def test_a_device_that_comes_back_costs_the_pose_under_way_and_nothing_else(tmp_path, kind, name):
    found = small_rig(simulation={"faults": [{"kind": kind, "pose": 1, "duration_s": 8}]})
    listener = captured(tmp_path / "s.h5", found)
    assert f"waiting for {name}, 30 s at most" in listener.warnings()
    assert "reconnecting" in listener.states
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete
        assert session.verify() == []
        assert f"{name} is there again (simulated-" in log_lines(session)
        assert session.poses[["pose", "accepted"]].tolist() == [(0, 1), (1, 0), (2, 1)]
        accepted = session.emissions[session.emissions["accepted"] == 1]
        assert accepted[accepted["pose"] == 2]["buzzer"].tolist() == [1, 7]
        assert len(gaps(session)) == (1 if kind == "audio_lost" else 0)
        assert ("the sound device was gone" in listener.warnings()) == (kind == "audio_lost")
        assert np.nanmax(np.abs(median_late_s(session))) < 0.01
        stamps_s = session.audio_blocks["host_time_s"]
        assert (np.diff(stamps_s).max() > 8) == (kind == "audio_lost")
        fired_s = session.emissions["host_time_s"]
        for begin_s in stamps_s[[0, *gaps(session)]]:  # its stamps need so long to settle
            assert fired_s[fired_s > begin_s].min() > begin_s + 3


@pytest.mark.parametrize("kind", ["trigger_lost", "camera_lost", "audio_lost"])
def test_a_device_that_does_not_come_back_ends_the_session_and_names_resume(tmp_path, kind):
    found = small_rig(
        capture={"device_wait_s": 3}, simulation={"faults": [{"kind": kind, "pose": 1, "duration_s": 100}]}
    )
    with pytest.raises(
        DeviceError,
        match=r"^the .* did not come back within 3 s, go on with --resume when it is there: .*; 1 pose saved",
    ) as end:
        captured(tmp_path / "s.h5", found)
    assert type(end.value) is DeviceError
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete
        assert session.poses["accepted"].tolist() == [1, 0]
        assert "go on with --resume" in log_lines(session)


def test_a_board_that_restarts_fires_again_within_the_pose(tmp_path):
    listener = captured(tmp_path / "s.h5", with_fault("trigger_reset", pose=1))
    assert "the simulated board restarted: check its cable and its power" in listener.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].tolist() == [1, 1]
        assert session.emissions["accepted"].tolist() == [1, 1, 0, 1, 1]
        assert session.emissions[session.emissions["accepted"] == 1]["buzzer"].tolist() == [1, 7, 1, 7]
        assert np.diff(session.pings["board_time_s"]).min() < 0  # its clock began anew
        assert np.abs(median_late_s(session)).max() < 0.005


def test_a_device_that_is_lost_again_and_again_is_given_up(tmp_path):
    found = small_rig()
    rig = capture_module.choose_devices(found.description)

    class LooseContact:
        def __getattr__(self, name):
            return getattr(rig.trigger, name)

        def play(self, buzzer, waveform):
            raise DeviceError("trigger board: no answer")

    monkeyed = replace(rig, trigger=LooseContact())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(capture_module, "choose_devices", lambda *_, **__: monkeyed)
        with pytest.raises(
            DeviceError, match="devices were lost 6 times without a good pose in between; 0 poses saved"
        ):
            captured(tmp_path / "s.h5", found)


def test_losses_are_counted_anew_after_a_good_pose(tmp_path, monkeypatch):
    rig, plays = capture_module.choose_devices(small_rig().description), []
    play = rig.trigger.play

    def stubborn(buzzer, waveform):
        plays.append(buzzer)
        if plays.count(1) in (1, 2, 3, 5, 6, 7):  # three times in each of two poses
            raise DeviceError("trigger board: no answer")
        return play(buzzer, waveform)

    monkeypatch.setattr(rig.trigger, "play", stubborn)
    monkeypatch.setattr(capture_module, "choose_devices", lambda *_, **__: rig)
    assert captured(tmp_path / "s.h5", poses=2).status.saved == 2
    assert plays.count(1) == 8


def test_a_second_device_lost_while_the_first_is_opened_is_brought_back_too():
    opened, reopened, description = [], [], small_rig().description

    def attend(part, _call, *, is_open):
        assert not is_open
        opened.append(part)
        if opened == ["trigger"]:
            raise DeviceLostError("gone", "audio")
        return "driver 1"

    recording = SimpleNamespace(
        rig=capture_module.choose_devices(description),
        status=Status("r", "s", (1,), 1, 1),
        say=lambda *_: None,
        attend=attend,
        reopened=reopened.append,
        record=lambda _: None,
    )
    Reconnection(recording, description).restore(DeviceLostError("lost", "trigger"))
    assert opened == ["trigger", "audio", "trigger"]
    assert reopened == ["audio", "trigger"]


def test_a_frozen_camera_is_opened_again_and_the_pose_repeated(tmp_path):
    listener = captured(tmp_path / "s.h5", with_fault("camera_frozen", pose=1))
    assert "camera: the simulated camera is frozen: take the cap off its lens" in listener.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].tolist() == [1, 0, 1]
        assert (np.diff(session.frames["host_time_s"]) > 0).all()


def test_samples_lost_without_a_word_flag_a_gap_and_fire_again(tmp_path):
    listener = captured(tmp_path / "s.h5", with_fault("clock_jump", pose=1))
    assert listener.warnings().count("of the recording: the clock says so") == 1
    with Session.open(tmp_path / "s.h5") as session:
        assert session.audio_blocks["flags"][gaps(session)].tolist() == [FLAG_GAP]
        assert np.diff(session.audio_blocks["host_time_s"]).max() > 0.25
        assert session.poses["accepted"].tolist() == [1, 1]
        assert session.emissions["expected_sample"][session.emissions["accepted"] == 0].tolist() == [-1]
        assert np.abs(median_late_s(session)).max() < 0.005


def test_a_wish_to_stop_is_heard_while_a_device_is_waited_for(tmp_path):
    listener = None
    found = small_rig(simulation={"faults": [{"kind": "audio_lost", "pose": 1, "duration_s": 100}]})
    path = tmp_path / "s.h5"
    asked = []

    def stop_wanted():
        asked.append(path.exists() and b"waiting for the sound device" in path.read_bytes())
        return asked[-1]

    with pytest.raises(InterruptedCaptureError, match="1 pose saved"):
        listener = captured(path, found, stop_wanted=stop_wanted)
    assert listener is None
    with Session.open(path) as session:
        assert session.complete


def test_a_disk_that_runs_short_ends_the_session_well(tmp_path, monkeypatch):
    free = iter([10**12] * 5)
    monkeypatch.setattr("acquire.disk.shutil.disk_usage", lambda _: Usage(0, 0, next(free, 70_000_000)))
    with pytest.raises(
        DiskShortError,
        match=r"disk is nearly full \(70 MB left, at least \d+ MB needed\): free .* saved in .*; go on with --resume$",
    ) as end:
        captured(tmp_path / "s.h5")
    assert end.value.exit_code == 3
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete
        assert session.verify() == []
        assert session.n_samples > 48000
        assert "the disk is nearly full" in log_lines(session)


def test_a_disk_that_is_short_already_is_refused_before_anything_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr("acquire.disk.shutil.disk_usage", lambda _: Usage(0, 0, 70_000_000))
    with pytest.raises(DiskShortError, match="70 MB left"):
        captured(tmp_path / "s.h5", with_fault("dead_channel", channel=99))
    assert not (tmp_path / "s.h5").exists()


def test_a_folder_that_is_moved_away_ends_the_session_well(tmp_path):
    class Mover(Listener):
        def say(self, message):
            super().say(message)
            if "pose 1 of 4 is good" in message.text:
                (tmp_path / "there").rename(tmp_path / "elsewhere")

    (tmp_path / "there").mkdir()
    with pytest.raises(DiskShortError, match=r"its folder is gone \(No such file or directory\): look") as end:
        captured(tmp_path / "there" / "s.h5", poses=4, screen=Mover())
    assert end.value.exit_code == 3
    with Session.open(tmp_path / "elsewhere" / "s.h5") as session:
        assert session.complete
        assert session.verify() == []
        assert session.poses["accepted"].sum() == 1


def test_a_session_that_may_not_fit_is_warned_of(tmp_path, monkeypatch):
    found = small_rig(audio={"sample_rate_hz": 96000}, capture={"poses": 400})
    monkeypatch.setattr("acquire.disk.shutil.disk_usage", lambda _: Usage(0, 0, 9_000_000_000))
    listener = captured(tmp_path / "s.h5", found, poses=1)
    assert not listener.warnings()
    asked = iter([False] * 3)
    with pytest.raises(InterruptedCaptureError):
        listener = captured(tmp_path / "t.h5", found, stop_wanted=lambda: next(asked, True))
    with Session.open(tmp_path / "t.h5") as session:
        assert "this session may take 2" in log_lines(session)
        assert " GB, the disk has room for 8.9 GB: free some space or choose another disk" in log_lines(session)


def test_a_folder_on_no_disk_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("acquire.disk.shutil.disk_usage", lambda _: Usage(0, 0, 0))
    with pytest.raises(TargetError, match="is no disk: choose another folder"):
        captured(tmp_path / "s.h5")


def test_a_disk_that_refuses_all_the_same_names_resume(tmp_path, monkeypatch):
    def refuse(writer, **_):
        raise SessionWriteError("s.h5: No space left on device")

    monkeypatch.setattr(SessionWriter, "append_emission", refuse)
    with pytest.raises(SessionWriteError, match=r"No space left on device; 0 poses saved in .*; go on with --resume$"):
        captured(tmp_path / "s.h5")


def test_a_second_ctrl_c_tells_what_is_in_the_file_and_how_to_go_on(tmp_path, monkeypatch):
    def interrupt(writer, **_):
        raise KeyboardInterrupt

    monkeypatch.setattr(SessionWriter, "append_emission", interrupt)
    with pytest.raises(
        InterruptedCaptureError, match=r"^interrupted at once; 0 poses saved in .*; go on with --resume$"
    ):
        captured(tmp_path / "s.h5")


def test_a_wish_to_stop_is_heard_while_a_device_is_being_opened(tmp_path):
    rig = capture_module.choose_devices(small_rig().description)

    class Hanging:
        def __getattr__(self, name):
            return getattr(rig.camera, name)

        def open(self):
            time.sleep(30)

    monkeyed = replace(rig, camera=Hanging(), clock=MonotonicClock())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(capture_module, "choose_devices", lambda *_, **__: monkeyed)
        with pytest.raises(InterruptedCaptureError, match="interrupted before the devices were open: nothing was rec"):
            captured(tmp_path / "s.h5", stop_wanted=lambda: True)
    assert not (tmp_path / "s.h5").exists()


def test_ctrl_c_that_ends_what_a_device_has_started_is_no_fault_of_the_device(tmp_path, monkeypatch):
    rig = capture_module.choose_devices(small_rig().description)
    pressed = Event()

    def crash():
        pressed.set()
        raise DeviceError("audio: PortAudio crashed")

    monkeypatch.setattr(rig.audio, "open", crash)
    monkeypatch.setattr(capture_module, "choose_devices", lambda *_, **__: rig)
    with pytest.raises(InterruptedCaptureError, match="interrupted before the devices were open"):
        captured(tmp_path / "s.h5", stop_wanted=pressed.is_set)


def test_digital_silence_on_all_microphones_is_named(tmp_path):
    channels = small_rig().description.audio.channels
    found = small_rig(simulation={"faults": [{"kind": "dead_channel", "channel": each} for each in channels]})
    with pytest.raises(CaptureQualityError, match="all microphones deliver digital silence: unmute"):
        captured(tmp_path / "s.h5", found)
    with Session.open(tmp_path / "s.h5") as session:
        lines = log_lines(session).splitlines()
    assert sum(line.startswith("all microphones deliver digital silence: unmute") for line in lines) == 1
    assert "check its cable and plug" not in "".join(lines)
