"""The simulated sound device and trigger board: clocks, blocks, faults."""

import time

import numpy as np
import pytest
from scripted_board import ScriptedBoard
from simulated import go_to_pose, joined, make_description, open_rig, record

from acquire.clock import MonotonicClock, VirtualClock
from acquire.devices.audio_portaudio import PortAudioInput
from acquire.devices.board_serial import SerialBoard
from acquire.devices.choose import choose_devices
from acquire.errors import DeviceError
from rigs.errors import DescriptionError
from rigs.session.layout import FLAG_OVERFLOW

WAVEFORM = make_description().signal.waveform()


def test_time_passes_only_virtually(monkeypatch):
    def no_sleep(duration_s):
        raise AssertionError(f"slept {duration_s} s")

    monkeypatch.setattr(time, "sleep", no_sleep)
    rig = open_rig()
    start_s = rig.clock.now_s()
    rig.trigger.play(1, WAVEFORM)
    rig.camera.read()
    blocks = record(rig, 60.0)
    assert 60 < rig.clock.now_s() - start_s < 61
    assert len(joined(blocks)) == pytest.approx((rig.clock.now_s() - 1000) * 48000, rel=0.05)


def test_clocks_move_forward():
    virtual, monotonic = VirtualClock(5.0), MonotonicClock()
    virtual.sleep_s(-1.0)
    virtual.sleep_s(2.0)
    assert virtual.now_s() == 7.0
    before_s = monotonic.now_s()
    monotonic.sleep_s(0.002)
    monotonic.sleep_s(-1.0)
    assert monotonic.now_s() >= before_s + 0.002


def test_an_emission_is_heard_when_the_host_believes_it_began():
    rig = open_rig()
    record(rig)
    start = rig.trigger.play(2, WAVEFORM)
    blocks = record(rig)
    sound = np.abs(joined(blocks)[:, 0])
    onset_s = blocks[0].host_time_s + np.flatnonzero(sound > 0.2 * sound.max())[0] / 48000
    assert onset_s == pytest.approx(start.host_time_s, abs=0.01)
    assert 0.05 < sound.max() < 0.6


def test_blocks_follow_one_another_and_their_stamps_jitter():
    rig = open_rig()
    blocks = record(rig, 20.0)
    sizes = np.array([len(block.samples) for block in blocks])
    adc_s = np.array([block.adc_time_s for block in blocks])
    host_s = np.array([block.host_time_s for block in blocks])
    assert np.allclose(np.diff(adc_s), sizes[:-1] / 48000, atol=1e-9)
    late_s = host_s - np.polyval(np.polyfit(adc_s, host_s, 1), adc_s)
    assert 0.0003 < late_s.std() < 0.003
    assert all(block.flags == 0 for block in blocks)
    assert blocks[0].samples.dtype == np.float32
    assert blocks[0].samples.shape[1] == 8


def test_the_same_sound_comes_whether_read_often_or_seldom():
    often, seldom = open_rig(), open_rig()
    often_blocks, seldom_blocks = record(often, 0.0), record(seldom, 0.0)
    for rig in (often, seldom):
        rig.trigger.play(1, WAVEFORM)
    for _ in range(50):
        often_blocks += record(often, 0.0125)
    seldom_blocks += record(seldom, 50 * 0.0125)
    assert joined(often_blocks).tobytes() == joined(seldom_blocks).tobytes()


def test_sound_is_the_same_for_a_seed_and_differs_between_seeds():
    def recorded(seed):
        rig = open_rig(seed)
        rig.trigger.play(1, WAVEFORM)
        return joined(record(rig, 0.3))

    first, again, other = recorded(1), recorded(1), recorded(2)
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


def test_the_descriptions_seed_is_used_when_none_is_given():
    description = make_description(simulation={"seed": 7})
    truths = [choose_devices(description, seed=seed).truth.microphones_m for seed in (None, 7, 8)]
    assert (truths[0] == truths[1]).all()
    assert (truths[0] != truths[2]).all()


def test_noise_is_as_far_below_the_sound_as_described():
    rig = open_rig(simulation={"snr_db": 20.0, "rt60_s": 0.0})
    noise = joined(record(rig, 1.0))
    rig.trigger.play(1, WAVEFORM)
    sound = joined(record(rig, 0.1))
    snr_db = 20 * np.log10(sound[1500:4500].std(axis=0) / noise.std(axis=0))
    assert (snr_db > 14).all()  # nearer than 1 m is louder
    assert (snr_db < 34).all()
    assert np.ptp(20 * np.log10(noise.std(axis=0))) > 0.5


def test_board_and_host_clocks_agree_but_for_offset_drift_and_jitter():
    rig = open_rig()
    starts = []
    for _ in range(40):
        starts.append(rig.trigger.play(1, WAVEFORM))
        rig.clock.sleep_s(2.0)
    board_s = np.array([start.board_time_s for start in starts])
    host_s = np.array([start.host_time_s for start in starts])
    slope, offset_s = np.polyfit(board_s, host_s, 1)
    late_s = host_s - (slope * board_s + offset_s)
    assert 0.00002 < late_s.std() < 0.0005
    assert abs(slope - 1) < 120e-6
    assert abs(offset_s) > 100


def test_the_trigger_board_refuses_what_it_cannot_do():
    rig = open_rig()
    assert rig.trigger.play(1, WAVEFORM).board_time_s > 0
    with pytest.raises(DeviceError, match="busy"):
        rig.trigger.play(2, WAVEFORM)
    rig.clock.sleep_s(0.2)
    with pytest.raises(DeviceError, match="no buzzer 17"):
        rig.trigger.play(17, WAVEFORM)
    rig.trigger.close()
    rig.trigger.close()
    with pytest.raises(DeviceError, match="not open"):
        rig.trigger.play(1, WAVEFORM)


def test_devices_name_themselves():
    rig = choose_devices(make_description())
    assert [rig.trigger.open(), rig.audio.open(), rig.camera.open()] == [
        "simulated-board 1.0", "simulated-audio 1.0", "simulated-camera 1.0",
    ]  # fmt: skip


def test_a_real_sound_device_cannot_hear_a_simulated_board():
    with pytest.raises(DescriptionError, match="a simulated board makes no sound to record"):
        choose_devices(make_description(audio={"driver": "portaudio", "device": {"name": "x"}}))


def test_mixed_rigs_keep_the_time_of_the_host_and_know_no_truth():
    real = {"driver": "portaudio", "device": {"name": "x"}}
    rig = choose_devices(make_description(audio=real, trigger={"driver": "serial"}))
    assert isinstance(rig.clock, MonotonicClock)
    assert isinstance(rig.audio, PortAudioInput)
    assert isinstance(rig.trigger, SerialBoard)
    assert rig.truth is None


def test_a_rig_that_is_all_real_has_no_simulated_part():
    rig = choose_devices(
        make_description(
            audio={"driver": "portaudio", "device": {"name": "x"}},
            trigger={"driver": "serial"},
            camera={"driver": "opencv", "source": 0},
        )
    )
    assert not [part for part in vars(rig).values() if ".simulated." in type(part).__module__]


def test_the_sync_output_follows_the_wave_without_the_way_through_the_air():
    rig = open_rig(audio={"sync_channel": 11})
    record(rig, 0.2)
    start = rig.trigger.play(1, WAVEFORM)
    blocks = record(rig)
    sync, first = joined(blocks)[:, -1], blocks[0].host_time_s
    rate_hz = 48000
    template = WAVEFORM.sampled(rate_hz)
    onset = int(np.argmax(np.correlate(sync, template)))
    assert first + onset / rate_hz == pytest.approx(start.host_time_s, abs=0.01)
    n_edges = np.count_nonzero(np.diff(sync[onset : onset + len(template)] > 0.25))
    assert n_edges == pytest.approx(2 * WAVEFORM.duration_s * np.mean(WAVEFORM.band_hz()), abs=2)
    assert np.abs(sync[: onset - 100]).max() < 0.01
    assert 0.4 < np.abs(sync).max() < 0.9


def faulty_sound(fault, pose, buzzer=1):
    """Return the blocks of one emission at a pose, a fault being due from pose 1 on."""
    rig = open_rig(simulation={"faults": [fault | {"pose": 1}]})
    go_to_pose(rig, pose)
    record(rig, 0.0)
    rig.trigger.play(buzzer, WAVEFORM)
    return record(rig, 0.3)


def test_a_dead_channel_is_zero_from_its_pose_on():
    fault = {"kind": "dead_channel", "channel": 3}
    assert joined(faulty_sound(fault, 0))[:, 2].any()
    broken = joined(faulty_sound(fault, 1))
    assert not broken[:, 2].any()
    assert broken[:, 3].any()


def test_a_loud_channel_clips():
    fault = {"kind": "loud_channel", "channel": 4}
    assert np.abs(joined(faulty_sound(fault, 0))[:, 3]).max() < 0.9
    broken = joined(faulty_sound(fault, 1))
    assert (np.abs(broken[:, 3]) >= 1.0).sum() > 100
    assert np.abs(broken[:, 2]).max() < 0.9


def test_a_silent_buzzer_is_not_heard_but_answers():
    fault = {"kind": "silent_buzzer", "buzzer": 2}
    assert np.abs(joined(faulty_sound(fault, 0, buzzer=2))).max() > 0.05
    assert np.abs(joined(faulty_sound(fault, 1, buzzer=2))).max() < 0.02
    assert np.abs(joined(faulty_sound(fault, 1, buzzer=1))).max() > 0.05


def test_an_overflow_loses_samples_once_and_is_flagged():
    rig = open_rig(simulation={"faults": [{"kind": "audio_overflow", "pose": 1}]})
    blocks = []
    for pose in (0, 1, 2):
        go_to_pose(rig, pose)
        blocks += record(rig, 0.0)
        rig.trigger.play(1, WAVEFORM)
        blocks += record(rig)
    adc_s = np.array([block.adc_time_s for block in blocks])
    lost = np.rint(np.diff(adc_s) * 48000) - [len(block.samples) for block in blocks[:-1]]
    flagged = [index for index, block in enumerate(blocks) if block.flags & FLAG_OVERFLOW]
    assert len(flagged) == 1
    assert np.flatnonzero(lost > 0).tolist() == [flagged[0] - 1]
    assert lost.max() == 2000
    assert np.abs(blocks[flagged[0]].samples).max() > 0.05
    assert 4.5 < adc_s[flagged[0]] - adc_s[0] < 5.5  # pose 1 sounds 5.0 s after the first sample


@pytest.mark.parametrize("kind", ["trigger_lost", "audio_lost"])
def test_a_lost_device_says_so_from_its_pose_on(kind):
    rig = open_rig(simulation={"faults": [{"kind": kind, "pose": 1}]})
    use = rig.audio.read if kind == "audio_lost" else lambda: rig.trigger.play(1, WAVEFORM)
    use()
    go_to_pose(rig, 1)
    with pytest.raises(DeviceError, match=r"check its cable"):
        use()


def test_a_real_board_heard_in_the_simulated_room_can_be_lost_too():
    faults = {"faults": [{"kind": "trigger_lost", "pose": 1}]}
    with ScriptedBoard() as scripted:
        rig = choose_devices(make_description(trigger={"driver": "serial", "port": scripted.port}, simulation=faults))
        rig.trigger.open()
        rig.operator.ask_for_pose(0)
        rig.trigger.play(1, WAVEFORM)
        rig.operator.ask_for_pose(1)
        with pytest.raises(DeviceError, match=r"simulated fault trigger_lost; check its cable"):
            rig.trigger.play(1, WAVEFORM)
        rig.trigger.close()
        assert scripted.plays == 1


def test_a_closed_sound_device_says_so():
    rig = open_rig()
    rig.audio.close()
    rig.audio.close()
    with pytest.raises(DeviceError, match="not open"):
        rig.audio.read()
