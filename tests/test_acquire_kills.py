"""SIGKILL at any moment, in the middle of a write too, costs at most a second of sound and the pose under way."""

import sys

import pytest
from killed_captures import kills


@pytest.mark.skipif(sys.platform != "linux", reason="the shim is preloaded as Linux does it")
def test_twenty_kills_lose_nothing_that_was_reported(tmp_path):
    killed = list(kills(tmp_path, 20, seed=1, poses=2))
    assert len(killed) >= 15  # the others had ended before their kill came
    assert sum(kill.n_reported for kill in killed) >= 5
    assert [kill.complaint() for kill in killed if kill.complaint()] == []
