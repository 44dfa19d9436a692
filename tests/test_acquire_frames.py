"""The golden frames of the protocol, as the host sends and reads them; the firmware's tests read the same file."""

import re
from pathlib import Path

import pytest

from acquire.devices.wire import PROTOCOL_VERSION, Event, Reply, crc8, decode, encode, play_arguments
from rigs.waveform import Waveform

FRAMES = Path(__file__).parents[1] / "firmware" / "frames.txt"


def lines(mark: str) -> list[str]:
    """Return the frames of one direction that hold only printable text."""
    text = FRAMES.read_text().splitlines()
    return [line[2:] for line in text if line.startswith(mark + " ") and "\\x" not in line]


def well_formed(pattern: str) -> list[str]:
    """Return the host's frames of a form, but for those whose checksum is wrong on purpose."""
    followed = zip(FRAMES.read_text().splitlines(), [*FRAMES.read_text().splitlines()[1:], ""], strict=True)
    return [
        line[2:]
        for line, answer in followed
        if line.startswith("> ") and re.fullmatch(pattern, line[2:]) and not answer.startswith("< 0 err 1")
    ]


def as_sent(frame: str) -> bytes:
    """Put numbers and a checksum where the frame leaves them open."""
    content = frame.replace("fw=#.#.#", "fw=0.1.0").replace("#", "7").removesuffix("*??").encode()
    return b"%s*%02X" % (content, crc8(content)) if frame.endswith("*??") else content


@pytest.mark.parametrize("frame", [line for line in lines("<") if re.search(r"\*(..)$", line)])
def test_everything_the_board_says_is_understood(frame):
    message = decode(as_sent(frame))
    words = as_sent(frame).decode().rsplit("*", 1)[0].split()
    if words[0] == "!":
        assert isinstance(message, Event)
        assert message.kind == words[1]
    else:
        assert isinstance(message, Reply)
        assert message.seq == int(words[0])
        assert (message.error == 0) == (words[1] == "ok")
    fields = dict(word.split("=", 1) for word in words if "=" in word)
    assert dict(message.fields) == fields


@pytest.mark.parametrize("frame", well_formed(r"\d+ (hello|ping|stop|status|test)\*[0-9A-F]{2}"))
def test_the_host_asks_byte_for_byte_as_the_frames_do(frame):
    seq, verb = frame.split("*")[0].split()
    assert encode(int(seq), verb) == frame.encode() + b"\n"


def test_the_host_plays_byte_for_byte_as_the_frames_do():
    frames = well_formed(r"\d+ play \d+ [a-z0-9 ]+\*[0-9A-F]{2}")
    sweep = Waveform("sweep", 0.1, 1000.0, 8000.0)
    assert (encode(10, "play", *play_arguments(1, sweep)).decode().rstrip()) in frames
    tone = Waveform("tone", 0.005, 4000.0, 4000.0)
    assert (encode(11, "play", *play_arguments(6, tone)).decode().rstrip()) in frames


def test_the_frames_are_of_this_protocol():
    assert any(f"proto={PROTOCOL_VERSION} " in line for line in lines("<"))
