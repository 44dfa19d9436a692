"""The wire: lines to messages and back, and whatever else comes in."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquire.devices.wire import Event, LineDecoder, Reply, crc8, decode, encode, play_arguments
from rigs.waveform import Waveform


def line(text: str) -> bytes:
    return b"%s*%02X" % (text.encode(), crc8(text.encode()))


OK = line("17 ok on_us=123456")
BOOT = line("! boot name=buzzer-board reset=power") + b"\n"
REPLY = Reply(17, {"on_us": "123456"})


def decoded(content: bytes) -> list:
    return LineDecoder().feed(content)


def test_half_a_line_before_a_boot_is_never_read_even_where_its_checksum_fits():
    halves = [half for number in range(65536) if crc8(half := b"%d ok on_u" % number) == 0]
    assert len(halves) > 200  # one in 256
    for half in halves:
        decoder = LineDecoder()
        assert decode(half + BOOT.rstrip()) is not None
        (message,) = decoder.feed(half + BOOT)
        assert isinstance(message, Event)
        assert (message.kind, decoder.skipped) == ("boot", 1)


def test_the_checksum_is_the_published_one():
    assert crc8(b"123456789") == 0xF4
    assert crc8(b"") == 0


def test_a_command_is_one_line_of_words_and_a_checksum():
    assert encode(7, "ping") == b"7 ping*%02X\n" % crc8(b"7 ping")
    assert encode(65535, "play", 3, "mls", 10, 16000).startswith(b"65535 play 3 mls 10 16000*")


@pytest.mark.parametrize(
    ("waveform", "arguments"),
    [
        (Waveform("sweep", 0.1, 1000.0, 8000.0), (2, "sweep", 1000, 8000, 100000)),
        (Waveform("tone", 0.0050004, 440.0, 440.0), (2, "tone", 440, 5000)),
        (Waveform("mls", 1023 / 16000, 0.0, 8000.0, 10, 16000.0), (2, "mls", 10, 16000)),
    ],
)
def test_a_waveform_becomes_the_arguments_of_play(waveform, arguments):
    assert play_arguments(2, waveform) == arguments


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("17 ok on_us=123456", REPLY),
        ("17 ok on_us=123456 later=a=b word", Reply(17, {"on_us": "123456", "later": "a=b"})),
        ("0 err 1 checksum", Reply(0, error=1, error_name="checksum")),
        ("! off buzzer=2 us=5 seq=9 why=done", Event("off", {"buzzer": "2", "us": "5", "seq": "9", "why": "done"})),
        ("! news", Event("news")),
    ],
)
def test_messages_are_read(text, message):
    assert decode(line(text)) == message
    assert decode(line(text) + b"\r") == message


@pytest.mark.parametrize(
    "text", ["", "17", "17 maybe", "17 err", "17 err x checksum", "17 err 0 none", "-1 ok", "65536 ok", "x ok", "!"]
)
def test_lines_that_say_nothing_are_no_messages(text):
    assert decode(line(text)) is None


def test_a_message_without_a_checksum_is_none():
    assert decode(b"17 ok on_us=123456") is None
    assert decode(b"") is None


def test_no_single_wrong_bit_passes():
    for place, bit in itertools.product(range(len(OK)), range(8)):
        wrong = bytearray(OK)
        wrong[place] ^= 1 << bit
        assert decode(bytes(wrong)) in (None, REPLY)  # REPLY: a checksum digit in small letters
        assert decode(bytes(wrong)) is None or place >= len(OK) - 2


def test_over_long_lines_are_skipped():
    long = line("17 ok " + "k=" + "v" * 255)
    decoder = LineDecoder()
    assert decoder.feed(long + b"\n" + OK + b"\n") == [REPLY]
    assert decoder.skipped == 1


@given(st.binary(max_size=300))
def test_a_line_after_any_garbage_is_found(garbage):
    assert decoded(garbage + b"\n" + OK + b"\n")[-1] == REPLY


@given(st.lists(st.integers(0, 120), max_size=6))
def test_it_does_not_matter_how_the_bytes_come_in(cuts):
    stream = b"half\n" + OK + b"\r\n\n\xff\xfe\n" + BOOT + OK + b"\n"
    places = [0, *sorted(cuts), len(stream)]
    decoder = LineDecoder()
    messages = [message for low, high in itertools.pairwise(places) for message in decoder.feed(stream[low:high])]
    assert messages == decoded(stream)
    assert [type(message) for message in messages] == [Reply, Event, Reply]
    assert decoder.skipped == 2


def test_a_restart_in_mid_line_is_seen():
    decoder = LineDecoder()
    assert decoder.feed(OK[:9] + BOOT) == [Event("boot", {"name": "buzzer-board", "reset": "power"})]
    assert decoder.skipped == 1


def test_a_million_bytes_without_a_line_feed_take_no_memory():
    decoder = LineDecoder()
    noise = np.random.default_rng(0).integers(14, 256, 1000, dtype=np.uint8).tobytes()
    for _ in range(1000):
        assert decoder.feed(noise) == []
    assert len(decoder._rest) < 1000
    assert decoder.feed(b"\n" + OK + b"\n") == [REPLY]
