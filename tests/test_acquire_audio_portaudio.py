"""The sound device behind PortAudio: held up, frozen, refused, missing, orphaned."""

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from audio_inputs import PULSE, RATE_HZ, counted, lost_samples, pulse_source, wait_until
from disk_stall import stalling_disk
from virtual_bench.pulse import pulse_server

from acquire.devices.audio_portaudio import PortAudioInput
from acquire.devices.audio_stamps import Buffer
from acquire.devices.portaudio_child import BLOCK, Intake
from acquire.devices.recorder import Recorder
from acquire.errors import DeviceError
from acquire.sound_devices import SoundDevice, choose_sound_device, sound_devices
from rigs.description import Audio, AudioDevice
from rigs.session.layout import FLAG_OVERFLOW
from rigs.session.reader import Session

PROGRAM = Path(__file__).with_name("recording_program.py")
ALL_WELL = SimpleNamespace(input_overflow=False, input_underflow=False)
OVERFLOW = SimpleNamespace(input_overflow=True, input_underflow=False)
TIMES = SimpleNamespace(inputBufferAdcTime=1.0, currentTime=1.5)
DEVICES = [
    SoundDevice("Scarlett 18i20 USB: Audio (hw:1,0)", "ALSA", 20, 48000.0),
    SoundDevice("Scarlett 18i20 USB: Audio (hw:10,0)", "ALSA", 20, 48000.0),
    SoundDevice("pulse", "ALSA", 32, 44100.0),
    SoundDevice("pulse", "JACK Audio Connection Kit", 32, 44100.0),
    SoundDevice("pulse extra", "OSS", 2, 44100.0),
]


@pytest.mark.parametrize("how", ["disk", "interpreter"])
def test_being_held_up_for_three_seconds_costs_no_sample(tmp_path, how):
    wish = tmp_path / "stall"
    with pulse_server() as server:
        environment = stalling_disk(tmp_path, wish, 3) | server.environment
        command = [sys.executable, str(PROGRAM), str(tmp_path / "s.h5"), str(wish), how]
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            assert program.stdout.readline() == "recording\n"
            server.play(counted(12 * RATE_HZ))
            longest_s = float(program.stdout.readline())
        assert program.returncode == 0
    assert longest_s > 2.9, "nothing was held up"
    with Session.open(tmp_path / "s.h5") as session:
        assert lost_samples(session.audio(0, session.n_samples)) == 0
        assert not session.audio_blocks["flags"].any()


def test_a_device_that_falls_silent_is_reported_and_let_go_and_comes_back(capfd):
    with pulse_source() as (source, server):
        source.audio.open()
        server.freeze()
        with pytest.raises(DeviceError, match="has delivered nothing for a second: check its cable"):
            source.record(5.0)
        source.audio.close()
        server.thaw()
        source.audio.open()
        assert source.record(0.5)
        server.kill()
        with pytest.raises(DeviceError, match="is gone"):
            source.record(5.0)
    assert capfd.readouterr() == ("", "")


def test_a_sound_system_that_does_not_answer_is_reported(monkeypatch):
    monkeypatch.setattr("acquire.sound_devices._LIST_TIMEOUT_S", 1.0)
    with pulse_source() as (source, server):
        server.freeze()
        with pytest.raises(DeviceError, match="the sound system does not answer: restart it"):
            source.audio.open()
        server.thaw()


def test_the_recorder_ends_with_the_program_that_started_it():
    program = """
import time
from acquire.devices.audio_portaudio import PortAudioInput
from rigs.description import Audio
audio = PortAudioInput(Audio(driver="portaudio", device={"name": "pulse"}, channels=range(1, 9)))
audio.open()
print(audio._recorder._process.pid, flush=True)
time.sleep(100)
"""
    with pulse_server() as server:
        command = [sys.executable, "-c", program]
        with subprocess.Popen(command, env=server.environment, stdout=subprocess.PIPE, text=True) as parent:
            assert parent.stdout is not None
            recorder = int(parent.stdout.readline())
            assert is_running(recorder)
            server.freeze()  # so that it has nothing to write, and would not notice by that
            parent.kill()
        wait_until(lambda: not is_running(recorder))


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_rates_and_channels_that_the_device_cannot_do_are_refused():
    with pulse_source() as (source, _server):
        too_many = Audio(driver="portaudio", device={"name": "pulse"}, channels=(1, 2, 3, 99))
        with pytest.raises(DeviceError, match=r"channel 99 is asked for, but there is only .*: correct audio.channels"):
            PortAudioInput(too_many).open()
        device = choose_sound_device(AudioDevice(name="pulse"), sound_devices())
        recorder = Recorder(device, 8, 10_000_000)
        with pytest.raises(DeviceError, match=r"does not record 8 channels at 10000000 Hz \(.*\): .*sample_rate_hz"):
            recorder.start()
        recorder.stop()
        source.audio.open()


@pytest.mark.parametrize("rate_hz", [44100, 192000])
def test_it_records_at_other_rates(rate_hz):
    with pulse_source() as (_, _server):
        audio = PortAudioInput(
            Audio(driver="portaudio", device={"name": "pulse"}, channels=range(1, 9), sample_rate_hz=rate_hz)
        )
        audio.open()
        time.sleep(1.0)
        *blocks, last = audio.read()
        audio.close()
    duration_s = last.host_time_s - blocks[0].host_time_s
    assert sum(len(block.samples) for block in blocks) / duration_s == pytest.approx(rate_hz, rel=0.2)


def test_a_missing_library_names_the_package(tmp_path, monkeypatch):
    (tmp_path / "sounddevice.py").write_text("raise OSError('PortAudio library not found')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(
        DeviceError, match="PortAudio library is not installed: run `sudo apt-get install libportaudio2`"
    ):
        sound_devices()


def test_a_recorder_that_crashes_is_reported(tmp_path, monkeypatch):
    (tmp_path / "sounddevice.py").write_text("import os; os.abort()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(DeviceError, match="PortAudio crashed"):
        sound_devices()


OVERFLOWING = """
import os, threading, time
from types import SimpleNamespace

class PortAudioError(Exception):
    pass

query_hostapis = lambda: [{"name": "fake"}]
query_devices = lambda: [{"name": "mic", "hostapi": 0, "max_input_channels": 4, "default_samplerate": 48000.0}]
get_portaudio_version = lambda: (0, "fake 1, of today")

class RawInputStream:
    def __init__(self, *, callback, **_):
        self._callback = callback

    def start(self):
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self):
        times, wish = SimpleNamespace(inputBufferAdcTime=0.0, currentTime=0.0), os.environ["OVERFLOW"]
        while True:
            status = SimpleNamespace(input_overflow=os.path.exists(wish), input_underflow=False)
            self._callback(bytes(16 * 480), 480, times, status)
            if status.input_overflow:
                os.unlink(wish)
            time.sleep(0.01)
"""


def test_an_overflow_that_the_driver_tells_of_is_flagged_once(tmp_path, monkeypatch):
    (tmp_path / "sounddevice.py").write_text(OVERFLOWING)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("OVERFLOW", str(tmp_path / "now"))
    monkeypatch.setattr("acquire.devices.recorder._SETTLE_S", 0.1)
    audio = PortAudioInput(Audio.model_validate(PULSE | {"device": {"name": "mic"}, "channels": (1, 2, 3, 4)}))
    audio.open()
    flags = []
    try:
        flags += [block.flags for block in audio.read()]
        (tmp_path / "now").touch()
        wait_until(lambda: flags.extend(block.flags for block in audio.read()) or any(flags))
        wait_until(lambda: len(audio.read()) > 0)
    finally:
        audio.close()
    assert sum(flags) == FLAG_OVERFLOW


@pytest.mark.parametrize(
    ("wanted", "index"),
    [
        ({"name": "scarlett hw:1"}, 0),
        ({"name": "hw:10,0"}, 1),
        ({"name": "pulse", "host_api": "alsa"}, 2),
        ({"name": "PULSE", "host_api": "JACK"}, 3),
        ({"name": "extra"}, 4),
    ],
)
def test_a_device_is_found_by_whole_words_or_by_its_whole_name(wanted, index):
    assert choose_sound_device(AudioDevice(**wanted), DEVICES) is DEVICES[index]


def test_words_that_fit_several_devices_or_none_list_what_is_there():
    with pytest.raises(DeviceError, match=r"2 sound devices fit 'scarlett': .*hw:1,0.*hw:10,0") as error:
        choose_sound_device(AudioDevice(name="scarlett"), DEVICES)
    assert "pulse" not in str(error.value)
    with pytest.raises(DeviceError, match=r"no sound device fits 'cart' and host API 'ALSA': .*Scarlett.*pulse"):
        choose_sound_device(AudioDevice(name="cart", host_api="ALSA"), DEVICES)


def test_the_devices_are_listed_with_their_words():
    with pulse_server() as server:
        command = [sys.executable, "-c", "from acquire.cli import main; main()", "--list-devices"]
        run = subprocess.run(command, env=server.environment, capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    assert 'device: {name: "pulse", host_api: "ALSA"}' in run.stdout
    assert "Cameras" in run.stdout
    assert "Serial ports" in run.stdout
    assert not run.stderr


def test_a_missing_library_does_not_hide_the_other_devices(tmp_path):
    (tmp_path / "sounddevice.py").write_text("raise OSError('PortAudio library not found')")
    command = [sys.executable, "-c", "from acquire.cli import main; main()", "--list-devices"]
    environment = dict(os.environ) | {"PYTHONPATH": str(tmp_path)}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 3
    assert "Serial ports" in run.stdout
    assert run.stderr.count("\n") == 1
    assert "libportaudio2" in run.stderr


def taken(intake):
    head, samples = intake.take()
    frames, has_lost, *_ = BLOCK.unpack(head)
    return frames, bool(has_lost), samples


def test_times_increase_even_after_a_block_that_came_late():
    """The second block came 60 ms late, with the third right behind it, but in another call."""
    late = [[heard(0.05, 1.05), heard(0.05, 1.16)], [heard(0.06, 1.161)]]
    audio = PortAudioInput(Audio(driver="portaudio", device={"name": "pulse"}, channels=range(1, 9)))
    audio._recorder = SimpleNamespace(take=lambda: late.pop(0), stop=lambda: None)
    stamps_s = [block.host_time_s for _ in range(2) for block in audio.read()]
    assert sorted(set(stamps_s)) == stamps_s
    assert stamps_s == pytest.approx([1.0, 1.11, 1.11], abs=0.001)


def heard(duration_s, came_s):
    return Buffer(np.zeros((round(duration_s * RATE_HZ), 8), dtype=np.float32), came_s, 0.0, 0.0)


def test_an_overflow_is_told_with_the_block_that_comes_after_it():
    intake = Intake(max_frames=1000)
    intake.callback(b"a" * 40, 10, TIMES, ALL_WELL)
    intake.callback(b"b" * 40, 10, TIMES, OVERFLOW)
    intake.callback(b"c" * 40, 10, TIMES, ALL_WELL)
    assert [taken(intake)[1] for _ in range(3)] == [False, True, False]


def test_a_full_queue_drops_what_comes_and_says_so_once_there_is_room():
    intake = Intake(max_frames=20)
    for sample in b"abcd":
        intake.callback(bytes([sample]) * 40, 10, TIMES, ALL_WELL)
    assert [taken(intake)[1] for _ in range(2)] == [False, False]
    intake.callback(b"e" * 40, 10, TIMES, ALL_WELL)
    intake.callback(b"f" * 40, 10, TIMES, ALL_WELL)
    assert [taken(intake)[1:] for _ in range(2)] == [(True, b"e" * 40), (False, b"f" * 40)]


def test_a_small_block_finds_no_way_into_a_queue_that_dropped_a_large_one():
    intake = Intake(max_frames=100)
    intake.callback(b"a" * 380, 95, TIMES, ALL_WELL)
    intake.callback(b"b" * 40, 10, TIMES, ALL_WELL)  # dropped
    intake.callback(b"c" * 8, 2, TIMES, ALL_WELL)  # would fit
    assert taken(intake)[0] == 95
    intake.callback(b"d" * 8, 2, TIMES, ALL_WELL)
    assert taken(intake)[1:] == (True, b"d" * 8)


def test_a_stream_that_ends_ends_the_queue():
    intake = Intake(max_frames=20)
    intake.callback(b"a" * 40, 10, TIMES, ALL_WELL)
    intake.end()
    assert taken(intake)[0] == 10
    assert intake.take() is None
