"""The latency of the audio path: learnt in a wide window, followed, and learnt anew when it changes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from capturing import captured, small_rig

from acquire import capture as capture_module
from acquire.latency import Latency
from rigs.session.layout import CLOCK_AUDIO, CLOCK_BOARD, CLOCK_CAMERA, CLOCK_SESSION
from rigs.session.reader import Session


class Delayed:
    """A sound device whose samples are older than its stamps say, by more from some moment on."""

    def __init__(self, audio, delay_s, later_s, change_s):
        self._audio, self._delay_s, self._later_s, self._change_s = audio, delay_s, later_s, change_s

    def __getattr__(self, name):
        return getattr(self._audio, name)

    def read(self):
        return [
            replace(block, host_time_s=block.host_time_s + self._at(block.host_time_s)) for block in self._audio.read()
        ]

    def _at(self, time_s):
        return self._delay_s if time_s < self._change_s else self._later_s


def capture_delayed(monkeypatch, path, delay_s, later_s=0.0, change_s=np.inf, **sections):
    choose = capture_module.choose_devices

    def chosen(description, *, seed=None):
        rig = choose(description, seed=seed)
        return replace(rig, audio=Delayed(rig.audio, delay_s, later_s, change_s))

    monkeypatch.setattr(capture_module, "choose_devices", chosen)
    return captured(path, small_rig(**sections))


@pytest.mark.parametrize("delay_s", [-0.03, 0.0, 0.12, 0.37])
def test_the_latency_is_learnt_and_taken_into_account(tmp_path, monkeypatch, delay_s):
    listener = capture_delayed(monkeypatch, tmp_path / "s.h5", delay_s)
    assert not listener.warnings()
    assert any("latency of the audio: " in message.text for message in listener.messages)
    with Session.open(tmp_path / "s.h5") as session:
        onsets, rate_hz = session.onsets, session.sample_rate_hz
        assert session.emissions["accepted"].tolist() == [1] * 4
        assert np.isnan(onsets["latency_s"][0])
        assert onsets["latency_s"][1:] == pytest.approx([delay_s + 0.002] * 3, abs=0.003)
        assert onsets["predicted_sample"] == pytest.approx(session.emissions["expected_sample"], abs=0.51)
        late_s = (onsets["measured_sample"] - onsets["predicted_sample"]) / rate_hz
        assert np.abs(late_s).max() < 0.003
        assert (np.abs(late_s[1:]) < 4 * onsets["predicted_std_s"][1:]).all()
        assert (onsets["predicted_std_s"] < 0.005).all()


def test_every_emission_is_stored_with_the_lines_it_was_placed_with(tmp_path, monkeypatch):
    capture_delayed(monkeypatch, tmp_path / "s.h5", 0.05)
    with Session.open(tmp_path / "s.h5") as session:
        fits = session.clock_fits
        assert [np.count_nonzero(fits["clock"] == clock) for clock in (CLOCK_AUDIO, CLOCK_BOARD)] == [4, 4]
        assert [np.count_nonzero(fits["clock"] == clock) for clock in (CLOCK_CAMERA, CLOCK_SESSION)] == [1, 1]
        assert fits["std_s"][fits["clock"] == CLOCK_CAMERA] == pytest.approx(0.1)
        for emission, board, audio, onset in zip(
            session.emissions,
            fits[fits["clock"] == CLOCK_BOARD],
            fits[fits["clock"] == CLOCK_AUDIO],
            session.onsets,
            strict=True,
        ):
            host_s = board["host_time_s"] + (emission["board_time_s"] - board["reading"]) / board["rate"]
            assert host_s == pytest.approx(emission["host_time_s"], abs=3 * board["std_s"])
            sample = audio["reading"] + (host_s - audio["host_time_s"]) * audio["rate"]
            late_s = (onset["measured_sample"] - sample) / session.sample_rate_hz
            assert late_s == pytest.approx(0.052, abs=0.004)
        assert len(session.pings) == 8 + 2 * 4


def test_the_sample_rate_is_measured(tmp_path, monkeypatch):
    listener = capture_delayed(monkeypatch, tmp_path / "s.h5", 0.0, capture={"poses": 6})
    with Session.open(tmp_path / "s.h5") as session:
        fit = session.clock_fits[session.clock_fits["clock"] == CLOCK_SESSION][0]
        blocks = session.audio_blocks
        true_hz = np.diff(blocks["first_sample"][[0, -1]]) / np.diff(blocks["adc_time_s"][[0, -1]])
    assert abs(fit["rate"] / true_hz[0] - 1) < 100e-6  # the driver's clock is the sound device's own, 40 ppm off
    assert any(
        "the sound device sampled at 4" in message.text and "ppm" in message.text for message in listener.messages
    )


@pytest.mark.parametrize("later_s", [0.25, -0.02])
def test_a_latency_that_changes_for_good_is_learnt_anew(tmp_path, monkeypatch, later_s):
    capture_delayed(monkeypatch, tmp_path / "s.h5", 0.05, later_s, change_s=1006.0, capture={"poses": 4})
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].sum() == 4
        first, last = session.onsets["latency_s"][[1, -1]]
        assert first == pytest.approx(0.052, abs=0.003)
        assert last == pytest.approx(later_s + 0.002, abs=0.003)


def test_one_outlier_does_not_move_the_latency():
    latency = Latency(0.03)
    assert latency.window_s() == (-0.05, 0.4)
    for offset_s in (0.1, 0.101, 0.125, 0.099, 0.1):
        latency.learn(offset_s)
    assert latency.value_s == pytest.approx(0.1)
    assert latency.window_s() == pytest.approx((0.07, 0.13))
    latency.forget()
    assert not latency.is_known


def test_one_sound_that_contradicts_does_not_count_and_two_that_agree_do():
    latency = Latency(0.03)
    assert latency.learn(0.197)
    assert not latency.is_confirmed
    assert not latency.learn(0.302)
    assert not latency.learn(0.072)
    assert latency.value_s == pytest.approx(0.197)
    assert not latency.learn(0.301)
    assert latency.changes == 0
    assert latency.learn(0.303)
    assert latency.is_confirmed
    assert latency.changes == 1
    assert latency.value_s == pytest.approx(0.302)


def test_what_was_known_before_confirms_the_latency_of_a_path_that_is_as_it_was():
    latency = Latency(0.03)
    for offset_s in (0.3, 0.301, 0.302):
        latency.learn(offset_s)
    latency.forget()
    assert not latency.is_known
    assert latency.learn(0.304)
    assert latency.is_confirmed
    latency.forget()
    assert latency.learn(0.1)
    assert not latency.is_confirmed
    assert latency.changes == 0


class Misheard:
    """A board whose first emissions sound earlier than it says, and all of them later: the first ones mislead."""

    def __init__(self, trigger, n_early, early_s):
        self._trigger, self._n_early, self._early_s = trigger, n_early, early_s

    def __getattr__(self, name):
        return getattr(self._trigger, name)

    def play(self, buzzer, waveform):
        start = self._trigger.play(buzzer, waveform)
        self._n_early -= 1
        off_s = 0.2 - self._early_s * (self._n_early >= 0)
        return replace(start, host_time_s=start.host_time_s - off_s)


@pytest.mark.parametrize("early_s", [0.105, 0.05, -0.08])
def test_a_latency_learnt_from_another_sound_costs_the_pose_and_is_learnt_anew(tmp_path, monkeypatch, early_s):
    choose = capture_module.choose_devices

    def chosen(description, *, seed=None):
        rig = choose(description, seed=seed)
        return replace(rig, trigger=Misheard(rig.trigger, 1, early_s))

    monkeypatch.setattr(capture_module, "choose_devices", chosen)
    listener = captured(tmp_path / "s.h5", small_rig(capture={"poses": 2}))
    what = f"{1e3 * abs(early_s):.0f} ms too {'late' if early_s > 0 else 'early'}; firing it again"
    assert re.search(rf"pose 1 of 2, buzzer 7: heard {what}", listener.warnings())
    assert "its emissions disagree on the latency of the audio" in listener.warnings()
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].tolist() == [0, 1, 1]
        assert session.emissions["accepted"].tolist() == [1, 0, 1, 1, 1, 1, 1]
        late_s = session.onsets["measured_sample"] - session.emissions["expected_sample"]
        assert np.abs(late_s[2:]).max() / session.sample_rate_hz < 0.004
