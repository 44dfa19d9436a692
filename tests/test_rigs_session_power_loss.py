"""A power loss tears whatever was not synced; what was flushed before the last sync is recovered all the same."""

import sys

import numpy as np
import pytest
from crash_images import MARKER, logged_session, power_losses
from example_sessions import samples

from rigs.session.reader import Session
from rigs.session.recover import recover

BLOCK = 1024
N = 40
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the shim is preloaded as Linux does it")


def test_power_losses_leave_everything_that_was_synced(tmp_path):
    images = list(power_losses(logged_session(tmp_path, n_poses=60), N, seed=2))
    assert len(images) == N
    assert sum(image.n_samples > 0 for image in images) > N // 2  # of the others nothing had been synced yet
    for image in images:
        path = image.write(tmp_path)
        copy = path.with_name("copy.h5")
        recover(path, copy)
        assert image.complaint(copy) == ""
        with Session.open(copy) as session:
            for block in range(image.n_samples // BLOCK):
                np.testing.assert_array_equal(session.audio(block * BLOCK, BLOCK), samples(block, BLOCK))


def test_every_run_writes_the_same(tmp_path):
    def written(name):
        (tmp_path / name).mkdir()
        events = logged_session(tmp_path / name, n_poses=15)
        return [(each.operation, each.file, each.offset, len(each.content)) for each in events]

    first = written("first")
    assert {file for _, file, _, _ in first} >= {MARKER}
    assert written("second") == first
