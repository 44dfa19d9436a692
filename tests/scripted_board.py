"""A board on a real pseudo-terminal that speaks the protocol and makes the faults that a test asks for."""

from __future__ import annotations

import os
import threading
import time
import tty
from collections import defaultdict

from acquire.devices.wire import crc8

HELLO = "name=buzzer-board fw=1.2.3 proto=1 board=uno buzzers=6 max_us=500000 min_hz=50 max_hz=20000"


def framed(text: str) -> bytes:
    return b"%s*%02X\n" % (text.encode(), crc8(text.encode()))


def half_with_checksum_0(seq: str) -> bytes:
    """Return the first half of a reply to `play` whose CRC is 0: whatever is glued to it keeps a checksum that fits."""
    halves = (f"{seq} ok on_us={number}".encode() for number in range(10_000_000))
    return next(half for half in halves if crc8(half) == 0)


class ScriptedBoard:
    """Answers as firmware does; `faults[verb]` is a list of faults, one for each coming command of that verb.

    lose command: not carried out; lose reply: carried out, events sent; lose all: carried out in silence;
    spoil command: checksum error; spoil reply: garbled; old reply: an older sequence number first; garbage: before the
    reply; noise before: a line of noise came before the command, and is answered first; busy, fault: refused so;
    restart: forgets everything in mid-line; unlucky restart: and the checksum of that half line is 0, so that it fits
    what follows as well; late reply: restart, and the reply to this one comes right before that to the next
    command `late_for`; mute: no answer to anything any more.
    """

    def __init__(self, *, hello: str = HELLO, raw: bytes | None = None) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self.hello, self.raw = hello, raw
        self.faults: dict[str, list[str]] = defaultdict(list)
        self.commands: list[str] = []
        self.started: list[int] = []
        self.state = "idle"
        self.play_lag_s = 0.0  # how much longer a sound lasts than it was told to
        self._ends = False
        self._mute = False
        self.late_for, self._late = "", b""
        self._restart()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def __enter__(self) -> ScriptedBoard:
        return self

    def __exit__(self, *_: object) -> None:
        self._ends = True
        os.write(self._slave, b"")
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def say(self, content: bytes) -> None:
        os.write(self._master, content)

    def restart(self, reset: str = "brownout") -> None:
        self._restart()
        self.say(framed(f"! boot name=buzzer-board fw=1.2.3 proto=1 board=uno reset={reset}"))

    def verbs(self) -> list[str]:
        return [command.split(" ")[1] for command in self.commands]

    def _restart(self) -> None:
        self._start_s, self.plays, self._busy_until_us = time.monotonic(), 0, 0

    def _now_us(self) -> int:
        return round(1e6 * (time.monotonic() - self._start_s)) % (1 << 32)

    def _state(self) -> str:
        return "playing" if self.state == "idle" and self._now_us() < self._busy_until_us else self.state

    def _serve(self) -> None:
        os.set_blocking(self._master, False)
        rest = b""
        while not self._ends:
            try:
                rest += os.read(self._master, 4096)
            except BlockingIOError:
                time.sleep(0.001)
                continue
            *lines, rest = rest.split(b"\n")
            for line in lines:
                if self.raw is not None:
                    self.say(self.raw)
                elif not self._mute:
                    self._answer(line.decode())

    def _answer(self, line: str) -> None:
        text, _, digits = line.rpartition("*")
        assert digits == f"{crc8(text.encode()):02X}"
        self.commands.append(text)
        seq, verb, *arguments = text.split(" ")
        self._say_late(verb)
        fault = self.faults[verb].pop(0) if self.faults[verb] else ""
        if verb == "play" and self._now_us() < self._busy_until_us:
            fault = "busy"
        refusals = {"spoil command": "0 err 1 checksum", "busy": f"{seq} err 6 busy", "fault": f"{seq} err 8 fault"}
        if fault in refusals:
            self.say(framed(refusals[fault]))
        elif fault in ("restart", "unlucky restart", "late reply"):
            self._restart_instead(fault, seq)
        elif fault != "lose command":
            self._mute = fault == "mute"
            reply = self._reply(seq, verb, arguments, silent=fault in ("lose all", "mute"))
            if fault not in ("lose reply", "lose all", "mute"):
                self._send(framed(f"{seq} ok {reply}"), fault, seq)

    def _say_late(self, verb: str) -> None:
        if verb == self.late_for:
            self.say(self._late)
            self._late = b""

    def _restart_instead(self, fault: str, seq: str) -> None:
        if fault == "late reply":
            self._late = framed(f"{seq} ok was=0")
        else:
            self.say(f"{seq} ok on_u".encode() if fault == "restart" else half_with_checksum_0(seq))
        self.restart()

    def _send(self, reply: bytes, fault: str, seq: str) -> None:
        if fault == "noise before":
            self.say(framed("0 err 2 line"))
            time.sleep(0.02)
        if fault == "spoil reply":
            reply = reply.replace(b"=", b"-")
        elif fault == "old reply":
            reply = framed(f"{int(seq) - 1} ok us=1 on_us=1 plays=99 state=playing") + reply
        elif fault == "garbage":
            reply = b"\x00\xff 17 ok us=3\nhalf a l\n" + b"x" * 500 + b"\n" + reply
        self.say(reply)

    def _reply(self, seq: str, verb: str, arguments: list[str], *, silent: bool) -> str:
        if verb == "play":
            self.plays += 1
            self.started.append(self._now_us())
            self._busy_until_us = self.started[-1] + int(arguments[-1]) + round(1e6 * self.play_lag_s)
            if not silent:
                self.say(framed(f"! on buzzer=1 us={self.started[-1]} seq={seq}"))
            return f"on_us={self.started[-1]}"
        return {
            "hello": self.hello,
            "stop": "was=0",
            "ping": f"us={self._now_us()}",
            "status": f"state={self._state()} buzzer=0 us=1 plays={self.plays} errors=0 fault=0 reset=power",
        }[verb]
