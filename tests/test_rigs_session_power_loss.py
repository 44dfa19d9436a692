"""A power loss tears whatever was not synced; what was flushed before the last sync is recovered all the same."""

import sys

import numpy as np
import pytest
from crash_images import logged_session, power_losses
from example_sessions import samples

from rigs.session.reader import Session
from rigs.session.recover import recover

BLOCK = 1024


@pytest.mark.skipif(sys.platform != "linux", reason="the shim is preloaded as Linux does it")
def test_power_losses_leave_everything_that_was_synced(tmp_path):
    n_safe = n_tried = 0
    for number, image in enumerate(power_losses(logged_session(tmp_path, n_poses=60), 40, seed=2)):
        folder = tmp_path / str(number)
        folder.mkdir()
        recovery = recover(image.write(folder), folder / "copy.h5")
        with Session.open(folder / "copy.h5") as session:
            assert session.verify() == []
            assert session.n_samples >= image.n_samples
            assert recovery.n_frames >= image.n_frames
            assert recovery.n_accepted >= image.n_poses
            for block in range(image.n_samples // BLOCK):
                np.testing.assert_array_equal(session.audio(block * BLOCK, BLOCK), samples(block, BLOCK))
        n_tried, n_safe = n_tried + 1, n_safe + (image.n_samples > 0)
    assert n_safe > n_tried // 2  # of the others nothing had been synced yet
