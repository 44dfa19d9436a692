"""The private PulseAudio: what is played comes back through PortAudio, each channel as late as it was played."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from virtual_bench.pulse import pulse_server

RECORD = """
import json, sounddevice
import numpy as np
heard = np.zeros((0, 8), np.float32)
with sounddevice.InputStream(device="pulse", channels=8, samplerate=48000, dtype="float32", latency=0.2) as stream:
    print("recording", flush=True)
    while (heard[:, 7] > 0.5).sum() == 0 and len(heard) < 60 * 48000:
        heard = np.concatenate([heard, stream.read(4800)[0]])
print(json.dumps([int(np.argmax(channel)) for channel in heard.T]))
"""


def test_what_is_played_comes_back_to_the_sample() -> None:
    clicks = np.zeros((48000, 8), np.float32)
    clicks[24000 + 7 * np.arange(8), np.arange(8)] = 0.9
    with pulse_server() as server:
        command = [sys.executable, "-c", RECORD]
        with subprocess.Popen(command, env=server.environment, stdout=subprocess.PIPE, text=True) as recorder:
            assert recorder.stdout is not None
            assert recorder.stdout.readline() == "recording\n"
            playing = server.play(clicks)
            heard = np.array(json.loads(recorder.stdout.readline()))
        playing.wait()
    np.testing.assert_array_equal(heard - heard[0], 7 * np.arange(8))


def test_a_server_that_was_killed_is_gone() -> None:
    with pulse_server() as server:
        server.kill()
        with pytest.raises(subprocess.CalledProcessError):
            server.control("info")
