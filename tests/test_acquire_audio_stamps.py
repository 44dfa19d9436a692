"""The stamps of audio blocks: split deliveries, late callbacks, and drivers whose own times are worth nothing."""

import numpy as np
import pytest

from acquire.devices.audio_stamps import Buffer, arrival_stamps_s, deliveries, driver_stamp_s, driver_times_are_sane
from rigs.session.layout import FLAG_OVERFLOW

RATE_HZ = 1000


def buffer(n_samples, came_s, age_s=0.0, flags=0, current_s=None):
    """Return a buffer; by the driver its first sample was taken `age_s` before it was complete."""
    current_s = came_s + 7e5 if current_s is None else current_s
    adc_s = current_s - n_samples / RATE_HZ - age_s
    return Buffer(np.full((n_samples, 2), came_s, dtype=np.float32), came_s, adc_s, current_s, flags)


def regular(n_buffers=20, jitter_s=0.0, **changes):
    """Return buffers of 50 samples that come as they are complete, some late."""
    late_s = np.random.default_rng(0).uniform(0, jitter_s, n_buffers)
    return [buffer(50, 1.05 + 0.05 * number + late_s[number], **changes) for number in range(n_buffers)]


def test_what_came_at_once_is_one_block():
    blocks = deliveries([buffer(48, 1.05), buffer(2, 1.0501), buffer(48, 1.1), buffer(3, 1.1001)])
    assert [len(block.samples) for block in blocks] == [50, 51]
    assert [driver_stamp_s(block) for block in blocks] == pytest.approx([1.002, 1.052])


def test_a_block_never_spans_a_loss():
    blocks = deliveries([buffer(48, 1.05), buffer(2, 1.0501, flags=FLAG_OVERFLOW), buffer(2, 1.0502)])
    assert [(len(block.samples), block.flags) for block in blocks] == [(48, 0), (4, FLAG_OVERFLOW)]


def test_a_late_callback_is_set_right_by_the_next_one():
    late = [buffer(50, 1.05), buffer(50, 1.13), buffer(50, 1.15)]
    assert arrival_stamps_s(late, RATE_HZ) == pytest.approx([1.0, 1.05, 1.1])
    assert arrival_stamps_s([], RATE_HZ) == []


def test_driver_times_that_keep_step_are_used():
    assert driver_times_are_sane(regular(age_s=0.02), RATE_HZ)
    assert driver_times_are_sane([], RATE_HZ)


@pytest.mark.parametrize(
    "buffers",
    [
        [Buffer(each.samples, each.came_s, 0.0, each.current_s) for each in regular()],
        [Buffer(each.samples, each.came_s, 0.0, 0.0) for each in regular()],
        [Buffer(each.samples, each.came_s, 99.0, each.current_s) for each in regular()],
        regular(age_s=0.6),
        regular(age_s=-0.2),
        regular()[:10] + regular(age_s=0.1)[10:],
    ],
    ids=["no ADC time", "no times", "constant", "half a second old", "not taken yet", "jumping"],
)
def test_driver_times_that_cannot_be_are_not_used(buffers):
    assert not driver_times_are_sane(buffers, RATE_HZ)
