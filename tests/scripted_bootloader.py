"""A bootloader on a real pseudo-terminal that speaks avrdude's language (STK500 version 1), on a chip with a fault."""

from __future__ import annotations

import os
import threading
import time
import tty

IN_SYNC, OK, END = b"\x14", b"\x10", 0x20
UNO_SIGNATURE = bytes.fromhex("1e950f")
ATMEGA168_SIGNATURE = bytes.fromhex("1e9406")  # of old Nanos
# Commands and how many bytes of them follow up to END; that of a page is told by the command itself.
N_MORE = {0x30: 1, 0x41: 2, 0x42: 21, 0x45: 6, 0x50: 1, 0x51: 1, 0x55: 3, 0x56: 5, 0x74: 4, 0x75: 1}
UNIVERSAL, LOAD_ADDRESS, WRITE_PAGE, READ_PAGE, PARAMETER, SIGNATURE = 0x56, 0x55, 0x64, 0x74, 0x41, 0x75


class ScriptedBootloader:
    """Takes an image and gives it back; bits of `stuck_low` at address 5 do not keep what is written."""

    def __init__(self, *, signature: bytes = UNO_SIGNATURE, stuck_low: int = 0) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.flash = bytearray(b"\xff" * 32768)
        self._signature, self._stuck_low = signature, stuck_low
        self._address = 0
        self._rest = b""
        self._ends = False
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def __enter__(self) -> ScriptedBootloader:
        return self

    def __exit__(self, *_: object) -> None:
        self._ends = True
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _serve(self) -> None:
        while not self._ends:
            try:
                self._rest += os.read(self._master, 4096)
            except BlockingIOError:
                time.sleep(0.001)
            while (command := self._next_command()) is not None:
                os.write(self._master, IN_SYNC + self._answer(command) + OK)

    def _next_command(self) -> bytes | None:
        if not self._rest:
            return None
        n_more = N_MORE.get(self._rest[0], 0)
        if self._rest[0] == WRITE_PAGE:
            n_more = 4 + int.from_bytes(self._rest[1:3], "big") if len(self._rest) > 2 else len(self._rest)
        if len(self._rest) <= n_more:
            return None
        command, self._rest = self._rest[: n_more + 1], self._rest[n_more + 1 :]
        return command

    def _answer(self, command: bytes) -> bytes:
        verb = command[0]
        if verb == LOAD_ADDRESS:
            self._address = 2 * int.from_bytes(command[1:3], "little")  # counts words
        elif verb == WRITE_PAGE:
            self.flash[self._address : self._address + len(command) - 5] = command[4:-1]
            self.flash[5] &= ~self._stuck_low
        elif verb == READ_PAGE:
            return bytes(self.flash[self._address :][: int.from_bytes(command[1:3], "big")])
        return {PARAMETER: b"\x03", UNIVERSAL: b"\x00", SIGNATURE: self._signature}.get(verb, b"")
