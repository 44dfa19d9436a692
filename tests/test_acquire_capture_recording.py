"""The recording when a sound device misbehaves in ways that it does not tell."""

from dataclasses import replace

import numpy as np
import pytest
from capturing import Listener, small_rig

from acquire.devices.choose import choose_devices
from acquire.errors import DeviceError, DeviceLostError
from acquire.holdups import Cause, HoldUps
from acquire.recording import Recording
from acquire.status import Status
from rigs.session.layout import FLAG_GAP, FLAG_OVERFLOW
from rigs.session.reader import Session
from rigs.session.writer import SessionWriter


class Mute:
    """A sound device that was unplugged: no error, no samples."""

    def open(self):
        return "mute 1.0"

    def read(self):
        return []

    def close(self):
        pass


class Leaky:
    """A sound device that loses its 40th block and does not say so."""

    def __init__(self, audio):
        self._audio, self._count = audio, 0

    def open(self):
        return self._audio.open()

    def read(self):
        kept = []
        for block in self._audio.read():
            self._count += 1
            if self._count != 40:
                kept.append(block)
        return kept

    def close(self):
        self._audio.close()


def recording_of(rig, found, path, screen):
    rig.audio.open()
    channels = found.description.audio.recorded_channels()
    writer = SessionWriter.create(
        path,
        name="s",
        description_text=found.text,
        n_channels=len(channels),
        sample_rate_hz=found.description.audio.sample_rate_hz,
        versions={},
    )
    return writer, Recording(rig, writer, found.description, screen, Status("r", "s", channels, 1, 2), lambda: False)


def test_a_sound_device_that_falls_silent_is_lost(tmp_path):
    found = small_rig()
    rig = replace(choose_devices(found.description), audio=Mute())
    writer, recording = recording_of(rig, found, tmp_path / "s.h5", Listener())
    with writer, pytest.raises(DeviceError, match="has delivered nothing for 2 s: check that it is plugged in"):
        recording.record(5.0)


def test_samples_lost_without_a_word_are_found_by_the_clock(tmp_path):
    found = small_rig()
    rig = choose_devices(found.description)
    rig = replace(rig, audio=Leaky(rig.audio))
    screen = Listener()
    writer, recording = recording_of(rig, found, tmp_path / "s.h5", screen)
    with writer:
        recording.clocks.latency.learn(0.1)
        recording.record(8.0)
    assert not recording.clocks.latency.is_known  # the audio path may be another one now
    assert recording.sound.losses.n == 1
    assert "of the recording: the clock says so" in screen.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert np.count_nonzero(session.audio_blocks["flags"] & FLAG_GAP) == 1


def test_what_has_left_memory_is_not_given(tmp_path):
    found = small_rig()
    writer, recording = recording_of(choose_devices(found.description), found, tmp_path / "s.h5", Listener())
    with writer:
        recording.record(10.0)
        first, samples = recording.sound.samples(0, writer.n_samples)
        assert first > 0
        assert first + len(samples) == writer.n_samples
        assert len(recording.sound.samples(writer.n_samples, writer.n_samples + 100)[1]) == 0


class SlowWriter:
    """A writer on a disk that stands still for a while, once."""

    def __init__(self, writer, clock, at_sample, hold_up_s):
        self._writer, self._clock, self._at_sample, self._hold_up_s = writer, clock, at_sample, hold_up_s

    def __getattr__(self, name):
        return getattr(self._writer, name)

    def append_audio(self, samples, **stamps):
        if self._hold_up_s and self._writer.n_samples >= self._at_sample:
            self._clock.sleep_s(self._hold_up_s)
            self._hold_up_s = 0.0
        return self._writer.append_audio(samples, **stamps)


def test_a_slow_disk_is_warned_of_and_costs_no_sample(tmp_path):
    found, screen = small_rig(), Listener()
    rig = choose_devices(found.description)
    writer, recording = recording_of(rig, found, tmp_path / "s.h5", screen)
    recording.sound._writer = SlowWriter(writer, rig.clock, 96000, 3.0)
    with writer:
        recording.record(3.0)
        assert recording.status.backlog_s < 1
        recording.record(5.0)
    assert screen.warnings().count("s of audio had to wait for the disk, nothing of it is lost: record to another") == 1
    assert recording.sound.losses.n == 0
    with Session.open(tmp_path / "s.h5") as session:
        assert not session.audio_blocks["flags"].any()
        assert session.n_samples > 7.9 * 48000
        np.testing.assert_allclose(np.diff(session.audio_blocks["adc_time_s"]), 1024 / 48000, rtol=1e-6)


def test_a_sound_device_that_falls_silent_later_is_lost_within_a_second(tmp_path):
    found, screen = small_rig(), Listener()
    rig = choose_devices(found.description)
    writer, recording = recording_of(rig, found, tmp_path / "s.h5", screen)
    with writer:
        recording.record(3.0)
        rig.audio.read = list
        with pytest.raises(DeviceLostError, match="has delivered nothing for 1 s"):
            recording.record(1.2)


def test_stamps_that_step_back_tell_of_a_host_that_slept(tmp_path):
    found, screen = small_rig(), Listener()
    rig = choose_devices(found.description)
    writer, recording = recording_of(rig, found, tmp_path / "s.h5", screen)
    read = rig.audio.read
    with writer:
        recording.record(5.0)
        rig.audio.read = lambda: [replace(block, host_time_s=block.host_time_s - 0.5) for block in read()]
        recording.record(2.0)
    assert "the host's clock jumped by 0.50 s: did the computer sleep?" in screen.warnings()
    assert recording.sound.losses.n == 1


@pytest.mark.parametrize("drift", [0.0, 0.004])
def test_sound_is_ready_once_its_times_have_settled_or_after_a_while(tmp_path, drift):
    found, screen = small_rig(), Listener()
    rig = choose_devices(found.description)
    writer, recording = recording_of(rig, found, tmp_path / "s.h5", screen)
    read = rig.audio.read
    rig.audio.read = lambda: [replace(block, host_time_s=block.host_time_s * (1 + drift)) for block in read()]
    with writer:
        for _ in range(2):
            recording.sound.reopened()
            begin_s, said = rig.clock.now_s(), len(screen.messages)
            while not recording.sound.is_ready():
                recording.record(0.1)
            waited_s = rig.clock.now_s() - begin_s
            heard = [message.text for message in screen.messages[said:]]
            waiting = [text for text in heard if "until the sound device's times have settled, 15 s at most" in text]
            given_up = [text for text in heard if "times still shift 15 s after it was opened, going on" in text]
            assert (len(waiting), len(given_up)) == ((1, 1) if drift else (0, 0))
            assert 15 < waited_s < 16 if drift else 3 < waited_s < 4
            assert recording.sound.is_ready()


def test_a_flood_of_losses_is_one_line_that_says_how_much_is_missing_and_one_for_the_rest(tmp_path):
    found, screen = small_rig(), Listener()
    rig = choose_devices(found.description)
    writer, recording = recording_of(rig, found, tmp_path / "s.h5", screen)
    read, late_s = rig.audio.read, 0.0

    def lossy():
        nonlocal late_s
        blocks = []
        for block in read():
            late_s += 0.01 if late_s else 7.3
            blocks.append(replace(block, host_time_s=block.host_time_s + late_s, flags=FLAG_OVERFLOW))
        return blocks

    with writer:
        recording.record(4.0)
        rig.audio.read = lossy
        recording.record(0.3)
        rig.audio.read = lambda: [replace(block, host_time_s=block.host_time_s + late_s) for block in read()]
        recording.record(1.5)
    told = [message.text for message in screen.messages if "missing" in message.text]
    assert recording.sound.losses.n > 10
    assert len(told) == 2
    assert told[0].startswith("7.3 s of sound missing at 4.0 s of the recording: the sound device says so")
    assert told[1].startswith(f"{0.01 * (recording.sound.losses.n - 1):.1f} s of sound missing until 4.3 s, lost ")


def test_what_sound_waits_for_is_told(tmp_path):
    rig = choose_devices(small_rig().description)
    worked_s = 0.0
    holdups = HoldUps(rig.clock, lambda: worked_s)
    assert holdups.blame() is Cause.COMPUTER
    with holdups.during(Cause.PICTURES):
        rig.clock.sleep_s(2.0)
    assert holdups.blame() is Cause.COMPUTER  # it stood still
    with holdups.during(Cause.PICTURES):
        rig.clock.sleep_s(2.0)
        worked_s = 1.9
    with holdups.during(Cause.DISK):
        rig.clock.sleep_s(1.0)
    assert holdups.blame() is Cause.PICTURES
    with holdups.during(Cause.DISK):
        rig.clock.sleep_s(1.0)
    rig.clock.sleep_s(1.5)
    assert holdups.blame() is Cause.COMPUTER


def test_sound_is_stored_while_another_device_waits_and_left_alone_while_its_own_is_opened(tmp_path):
    found = small_rig()
    rig = choose_devices(found.description)
    writer, recording = recording_of(rig, found, tmp_path / "s.h5", Listener())

    def slowly(call, meanwhile):
        for _ in range(3):
            rig.clock.sleep_s(0.6)
            meanwhile()
        return call()

    rig.clock.wait_for = slowly
    with writer:
        recording.status.advice = "keep quiet"
        during = recording.attend("camera", lambda: (writer.n_samples, recording.status.advice))
        assert during[0] == pytest.approx(1.8 * 48000, rel=0.05)
        assert during[1] == "waiting for the camera"
        assert recording.status.advice == "keep quiet"
        assert recording.attend("audio", lambda: writer.n_samples, is_open=False) == during[0]
