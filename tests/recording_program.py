"""A program that records from PortAudio into a session and is held up on the way; arguments: FILE WISH HOW."""

import ctypes
import sys
import time
from pathlib import Path

import yaml
from simulated import make_description

from acquire.devices.audio_portaudio import PortAudioInput
from rigs.session.writer import SessionWriter

RECORD_S = 8.0
HOLD_AT_S = 2.0
HOLD_S = 3.0


def main(path: Path, wish: Path, how: str) -> None:
    audio = {"driver": "portaudio", "device": {"name": "pulse"}}
    description = make_description(audio=audio)
    microphones = PortAudioInput(description.audio)
    microphones.open()
    sys.stdout.write("recording\n")
    sys.stdout.flush()
    writer = SessionWriter.create(
        path,
        name="held up",
        description_text=yaml.safe_dump(description.model_dump(mode="json", exclude_none=True)),
        n_channels=8,
        sample_rate_hz=description.audio.sample_rate_hz,
        versions={},
    )
    start_s = time.monotonic()
    longest_s, is_held = 0.0, False
    with writer:
        while (now_s := time.monotonic()) < start_s + RECORD_S:
            if now_s > start_s + HOLD_AT_S and not is_held:
                is_held = True
                hold_up(wish, how)
            for block in microphones.read():
                writer.append_audio(
                    block.samples, host_time_s=block.host_time_s, adc_time_s=block.adc_time_s, flags=block.flags
                )
            longest_s = max(longest_s, time.monotonic() - now_s)
            time.sleep(0.1)
    microphones.close()
    sys.stdout.write(f"{longest_s}\n")


def hold_up(wish: Path, how: str) -> None:
    """Hold up the disk's next write, or every thread of this program at once."""
    if how == "disk":
        wish.touch()
    else:
        ctypes.PyDLL(None).usleep(round(1e6 * HOLD_S))  # PyDLL: the interpreter's lock stays held


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
