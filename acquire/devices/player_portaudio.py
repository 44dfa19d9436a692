"""The player: sound on the default output, through PortAudio, in a process of its own.

As with the recorder, what the libraries below print reaches nobody, and a driver that crashes takes only the player.
It is `rig-session audio --play` that calls it, by an entry point: a session knows no devices.
"""

from __future__ import annotations

import subprocess
import sys

import numpy as np
from numpy.typing import NDArray

from acquire.errors import DeviceError

GRACE_S = 20.0  # for the sound system to start and stop
LATENCY_S = 0.5  # a busy computer leaves no hole in the sound
TAIL_S = 2 * LATENCY_S  # of silence: ALSA's pulse plugin drops what is still buffered when a stream ends


def play(samples: NDArray[np.float32], sample_rate_hz: float) -> None:
    """Play samples (n_samples, n_channels), full scale = 1, to their end.

    Raises
    ------
    DeviceError
        There is no PortAudio, or no device to play on.
    """
    command = [sys.executable, "-m", __name__, str(round(sample_rate_hz)), str(samples.shape[1])]
    sound = np.clip(np.nan_to_num(samples), -1.0, 1.0).astype("<f4").tobytes()
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            command, input=sound, capture_output=True, timeout=len(samples) / sample_rate_hz + GRACE_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise DeviceError("the sound system does not answer: restart it, or write a file with -o") from error
    if done.returncode != 0:
        said = done.stdout.decode(errors="replace").strip().splitlines()
        raise DeviceError(
            f"the sound cannot be played ({said[-1] if said else 'the player crashed'}): check the default sound "
            "device, or write a file with -o"
        )


def main(sample_rate_hz: int, n_channels: int) -> int:
    """Play what comes on standard input; the last line of standard output says what went wrong."""
    try:
        import sounddevice  # noqa: PLC0415 - fails where PortAudio is not installed
    except (ImportError, OSError) as error:
        return _failed(error)
    samples = np.frombuffer(sys.stdin.buffer.read(), "<f4").reshape(-1, n_channels)
    samples = np.concatenate([samples, np.zeros((round(TAIL_S * sample_rate_hz), n_channels), "<f4")])
    try:
        sounddevice.play(samples, sample_rate_hz, blocking=True, latency=LATENCY_S)
    except (sounddevice.PortAudioError, ValueError) as error:
        return _failed(error)
    return 0


def _failed(error: BaseException) -> int:
    sys.stdout.write(f"\n{' '.join(str(error).split())}\n")
    return 1


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
