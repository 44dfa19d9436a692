"""What every sound device must do, whether simulated or behind PortAudio."""

import numpy as np
import pytest
from audio_inputs import RATE_HZ, pulse_source, simulated_source

from acquire.errors import DeviceError


@pytest.fixture(params=["simulated", "portaudio"])
def kind(request):
    return request.param


@pytest.fixture
def make_source(kind, monkeypatch):
    """Return a function that makes a source of some channels, not yet opened."""
    context = []

    def make(channels=tuple(range(1, 9))):
        if kind == "simulated":
            return simulated_source(monkeypatch, channels)
        context.append(pulse_source(channels))
        return context[-1].__enter__()[0]

    yield make
    for each in context:
        each.__exit__(None, None, None)


@pytest.fixture
def opened(make_source):
    source = make_source()
    source.audio.open()
    yield source
    source.audio.close()


def joined(blocks):
    return np.concatenate([block.samples for block in blocks])


def click_places(source):
    """Return the row at which each column hears its click."""
    source.record(0.3)
    source.sound()
    samples = np.abs(joined(source.record(2.0)))
    assert samples.max(axis=0).min() > 0.2, "some channel heard nothing"
    return np.argmax(samples, axis=0)


def test_it_names_its_driver_and_version(make_source):
    source = make_source()
    name, version, *_ = source.audio.open().split(" ")
    source.audio.close()
    assert name
    assert version.lstrip("V")[0].isdecimal()


def test_delays_between_channels_come_back_to_the_sample(opened):
    places = click_places(opened)
    np.testing.assert_array_equal(places - places[0], 7 * np.arange(8))


@pytest.mark.parametrize("channels", [(8, 7, 6, 5, 4, 3, 2, 1), (3, 1, 8, 6)])
def test_channels_come_in_the_order_of_the_map(make_source, channels):
    source = make_source(channels)
    source.audio.open()
    places = click_places(source)
    source.audio.close()
    np.testing.assert_array_equal(places - places[0], 7 * (np.array(channels) - channels[0]))


def test_blocks_are_float32_of_all_channels_at_times_that_agree_with_their_samples(opened):
    blocks = opened.record(2.0)
    assert all(block.samples.dtype == np.float32 and block.samples.shape[1] == 8 for block in blocks)
    assert not any(block.flags for block in blocks)
    n_samples = np.array([len(block.samples) for block in blocks])
    host_s = np.array([block.host_time_s for block in blocks])
    assert (np.diff(host_s) > 0).all()
    origin_s = host_s - (np.cumsum(n_samples) - n_samples) / RATE_HZ
    assert np.median(np.abs(origin_s - np.median(origin_s))) < 0.01  # a third of capture.onset_tolerance_s
    end_s = np.median(origin_s) + n_samples.sum() / RATE_HZ
    assert -1.0 < end_s - opened.clock.now_s() < 0.01


def test_what_came_is_handed_out_once(opened):
    opened.record(0.5)
    assert sum(len(block.samples) for block in opened.audio.read()) < 0.4 * RATE_HZ


def test_closing_twice_does_no_harm_and_reading_then_says_so(opened):
    opened.audio.close()
    opened.audio.close()
    with pytest.raises(DeviceError, match="not open; open it first"):
        opened.audio.read()


def test_it_opens_again_after_it_was_closed(opened):
    opened.audio.close()
    opened.audio.open()
    assert len(joined(opened.record(1.0))) > 0.5 * RATE_HZ


def test_a_device_that_is_gone_is_reported_within_a_second_or_so(opened):
    opened.record(0.3)
    opened.take_away()
    with pytest.raises(DeviceError, match=r"is gone[:;] check its cable"):
        opened.record(1.5)
