"""The command line rig-flash: what it says, what it runs, and every way in which it can fail without a board."""

import os
import re
import subprocess
import tty

import pytest
from scripted_bootloader import ATMEGA168_SIGNATURE, ScriptedBootloader
from simboard import OPTIBOOT, firmware, running_board

from acquire.avrdude import BOARDS, explain
from acquire.devices.board_serial import SerialBoard
from acquire.flash import cli
from acquire.ports import FoundPort, open_port
from rigs.command import run
from rigs.waveform import Waveform

# One byte of program: enough for avrdude to look for a bootloader.
TINY_IMAGE = ":0100000000FF\n:00000001FF\n"


@pytest.fixture
def image(tmp_path):
    path = tmp_path / "tiny.hex"
    path.write_text(TINY_IMAGE)
    return path


@pytest.fixture
def mute_port():
    """Return a pseudo-terminal behind which nobody is."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


@pytest.fixture
def ports(monkeypatch):
    def plug_in(*found):
        monkeypatch.setattr("acquire.flash.serial_ports", lambda: list(found))

    return plug_in


def rig_flash(*arguments):
    return run("rig-flash", cli, [str(argument) for argument in arguments])


@pytest.mark.parametrize(
    ("board", "words"),
    [
        ("uno", "-p atmega328p -c arduino -P /dev/ttyX -b 115200 -D -U flash:w:"),
        ("nano", "-p atmega328p -c arduino -P /dev/ttyX -b 115200 -D -U flash:w:"),
        ("nano-old", "-p atmega328p -c arduino -P /dev/ttyX -b 57600 -D -U flash:w:"),
        ("mega", "-p atmega2560 -c wiring -P /dev/ttyX -b 115200 -D -U flash:w:"),
    ],
)
def test_a_dry_run_says_what_would_be_done(capsys, mute_port, board, words):
    assert rig_flash("--port", mute_port, "--board", board, "--dry-run") == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"port {mute_port} (no USB ids): taken as board {board}\n")  # named, not found
    assert f"would run: avrdude {words.replace('/dev/ttyX', mute_port)}" in printed
    assert f"buzzer-board-{board.removesuffix('-old')}.hex" in printed


def test_a_dry_run_lists_the_build(capsys, mute_port, monkeypatch, tmp_path):
    monkeypatch.setattr("acquire.flash._IMAGES", tmp_path)  # what is not built yet is no hindrance
    assert rig_flash("--port", mute_port, "--board", "uno", "--build", "--dry-run") == 0
    _, first, second = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"would run: make -C \S+firmware images", first)
    assert second.startswith("would run: avrdude ")
    assert not list(tmp_path.iterdir())


def test_a_dry_run_sees_what_would_hinder(capsys, mute_port, monkeypatch, tmp_path):
    assert rig_flash("--port", "/dev/ttyNO", "--dry-run") == 3  # before it asks for --board
    assert "/dev/ttyNO: there is no such port" in capsys.readouterr().err
    assert rig_flash("--port", __file__, "--board", "uno", "--dry-run") == 3
    assert "cannot be opened as a serial port" in capsys.readouterr().err
    held = open_port(mute_port)
    assert rig_flash("--port", mute_port, "--board", "uno", "--dry-run") == 3
    held.close()
    said = capsys.readouterr()
    assert "another program uses this port" in said.err
    assert said.out == ""  # nothing is said to be found
    monkeypatch.setenv("PATH", str(tmp_path))
    assert rig_flash("--port", mute_port, "--board", "uno", "--dry-run") == 2
    assert "avrdude is not installed" in capsys.readouterr().err


def test_the_usb_ids_tell_the_board(capsys, ports, mute_port):
    ports(FoundPort(mute_port, "2341:0042", "55"))
    assert rig_flash("--dry-run") == 0
    printed = capsys.readouterr().out
    assert f"found {mute_port} (2341:0042:55, Arduino Mega 2560): taken as board mega" in printed
    assert "-c wiring" in printed


def test_ids_that_do_not_tell_the_board_ask_for_it(capsys, ports, mute_port):
    ports(FoundPort(mute_port, "1A86:7523"))
    assert rig_flash("--dry-run") == 2
    assert "does not tell which board it is: give --board uno, nano, nano-old, mega" in capsys.readouterr().err


def test_no_board_and_several_boards(capsys, ports):
    ports()
    assert rig_flash() == 3
    assert "rig-flash: no board found on any USB port: plug the board in" in capsys.readouterr().err
    ports(FoundPort("/dev/ttyACM0", "2341:0043"), FoundPort("/dev/ttyACM1", "2341:0043"))
    assert rig_flash() == 3
    assert "2 boards could be meant: unplug the others, or name the port" in capsys.readouterr().err


def test_a_port_that_is_not_there(capsys, image):
    assert rig_flash("--port", "/dev/ttyNO", "--board", "uno", "--image", image) == 3
    assert "rig-flash: /dev/ttyNO: there is no such port: plug the board in" in capsys.readouterr().err


def test_a_port_that_is_in_use(capsys, image, mute_port):
    held = open_port(mute_port)
    assert rig_flash("--port", mute_port, "--board", "uno", "--image", image) == 3
    held.close()
    assert "another program uses this port: close serial monitors" in capsys.readouterr().err


def test_a_board_that_does_not_answer_avrdude(capsys, image, mute_port, monkeypatch):
    monkeypatch.setattr("acquire.avrdude._HOPELESS", re.compile("attempt 1 of"))  # each takes 6 s
    assert rig_flash("--port", mute_port, "--board", "uno", "--image", image) == 3
    said = capsys.readouterr()
    assert "writing tiny.hex with avrdude" in said.out
    (line,) = said.err.splitlines()  # avrdude's own words are left out
    assert line.startswith(
        f"rig-flash: no bootloader of a uno answers at {mute_port} (not in sync): check that this is"
    )
    assert "nano" not in line


def test_what_avrdude_says_is_shown_on_request_and_where_it_is_not_understood(capsys, image, mute_port, monkeypatch):
    monkeypatch.setattr("acquire.avrdude._HOPELESS", re.compile("attempt 1 of"))
    assert rig_flash("--port", mute_port, "--board", "uno", "--image", image, "--verbose") == 3
    assert "programmer is not responding" in capsys.readouterr().err
    monkeypatch.setattr("acquire.avrdude._MEANINGS", {})
    assert rig_flash("--port", mute_port, "--board", "uno", "--image", image) == 3
    said = capsys.readouterr().err
    assert "programmer is not responding" in said
    assert said.splitlines()[-1].startswith(f"rig-flash: avrdude failed at {mute_port}, for the reason it gives above")


def test_bytes_that_are_no_text_are_no_fault_of_this_software(capsys, image, mute_port, monkeypatch, tmp_path):
    avrdude = tmp_path / "avrdude"
    avrdude.write_text("#!/bin/sh\nprintf 'avrdude: got \\377\\n'; exit 1\n")
    avrdude.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    assert rig_flash("--port", mute_port, "--board", "uno", "--image", image) == 3
    assert f"avrdude failed at {mute_port}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("board", "guess"), [("uno", ""), ("nano", "try --board nano-old"), ("nano-old", "try --board nano,"), ("mega", "")]
)
def test_the_other_bootloader_is_guessed_for_a_nano_only(board, guess):
    said = explain("avrdude: stk500_recv(): programmer is not responding", BOARDS[board], "/dev/ttyX")
    assert guess in said
    assert bool(guess) == ("try --board" in said)


def flashed_onto(bootloader, capsys):
    """Run rig-flash with the real avrdude; return the exit code and the one line it printed to stderr."""
    exit_code = rig_flash("--port", bootloader.port, "--board", "uno", "--image", firmware("uno", "hex"))
    (line,) = capsys.readouterr().err.splitlines()
    return exit_code, line


def test_a_board_that_does_not_keep_what_is_written(capsys):
    with ScriptedBootloader(stuck_low=0x80) as bootloader:
        exit_code, last = flashed_onto(bootloader, capsys)
        assert len(set(bootloader.flash[:8192])) > 100  # it was written
    assert exit_code == 3
    assert last.startswith(f"rig-flash: what stands on the board at {bootloader.port} is not what was written: try")


def test_a_chip_of_another_kind(capsys):
    with ScriptedBootloader(signature=ATMEGA168_SIGNATURE) as bootloader:
        exit_code, last = flashed_onto(bootloader, capsys)
        assert set(bootloader.flash) == {0xFF}  # nothing was written
    assert exit_code == 3
    assert last.startswith(f"rig-flash: the chip at {bootloader.port} is not the atmega328p of a uno: name the right")


@pytest.mark.parametrize(
    ("complaint", "meaning"),
    [
        ("OS error: cannot open port /dev/ttyX: Permission denied", "no permission to use /dev/ttyX: `sudo usermod"),
        ('ser_open(): can\'t open device "/dev/ttyX": Device or resource busy', "another program uses /dev/ttyX"),
        ("OS error: cannot open port /dev/ttyX: No such file or directory", "/dev/ttyX is gone: plug the board in"),
        ("Expected signature for ATmega328P is 1E 95 0F", "is not the atmega328p of a uno: name the right board"),
        ("error: verification mismatch", "is not what was written: try again, with another cable"),
        ("verification error, first mismatch at byte 0x0000", "is not what was written: try again"),
        ("device signature = 0x1e950f\navrdude error: verification mismatch", "is not what was written: try again"),
        ("stk500_getsync() attempt 10 of 10: not in sync: resp=0x00", "no bootloader of a uno answers at /dev/ttyX"),
    ],
)  # fmt: skip
def test_avrdudes_complaints_are_explained(complaint, meaning):
    assert meaning in explain(f"avrdude {complaint}\n", BOARDS["uno"], "/dev/ttyX")


def test_a_computer_without_avrdude_says_how_to_get_it(capsys, image, mute_port, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert rig_flash("--port", mute_port, "--board", "uno", "--image", image) == 2
    assert "avrdude is not installed: `sudo apt install avrdude`" in capsys.readouterr().err


def test_images_that_are_not_there(capsys, mute_port, monkeypatch, tmp_path):
    assert rig_flash("--port", mute_port, "--board", "uno", "--image", tmp_path / "no.hex") == 2
    assert "no.hex" in capsys.readouterr().err
    monkeypatch.setattr("acquire.flash._IMAGES", tmp_path)
    assert rig_flash("--port", mute_port, "--board", "uno") == 2
    assert "there is no such image: build it with --build in a source tree" in capsys.readouterr().err


def test_building_needs_the_sources(capsys, mute_port, monkeypatch, tmp_path):
    assert rig_flash("--port", mute_port, "--board", "uno", "--image", __file__, "--build") == 2
    assert "give one of the two" in capsys.readouterr().err
    monkeypatch.setattr("acquire.flash._FIRMWARE", tmp_path)
    assert rig_flash("--port", mute_port, "--board", "uno", "--build") == 2
    assert "--build works in a source tree only" in capsys.readouterr().err


def test_a_board_as_bought_is_flashed_and_tells_what_is_on_it(capsys):
    with running_board(OPTIBOOT, dtr=True) as board:
        assert rig_flash("--port", board.port, "--board", "uno", "--image", firmware("uno", "hex")) == 0
        printed = capsys.readouterr().out
        assert "written and verified; the board says: buzzer-board 1." in printed
        assert printed.endswith("on uno, 6 buzzers\n")
        opened = SerialBoard(board.port, Waveform("tone", 0.005, 1000.0, 1000.0), [1])
        assert opened.open().startswith("buzzer-board")
        opened.close()


CHATTER = """
#include <avr/io.h>
int main(void) {
    UCSR0A = _BV(U2X0), UCSR0B = _BV(TXEN0), UBRR0 = 16;
    for (;;) if (UCSR0A & _BV(UDRE0)) UDR0 = 'U';
}
"""


def test_an_image_that_is_not_ours_is_a_firmware_error(capsys, tmp_path):
    elf, image = tmp_path / "chatter.elf", tmp_path / "chatter.hex"
    build = ["avr-gcc", "-mmcu=atmega328p", "-Os", "-x", "c", "-", "-o", elf]
    subprocess.run(build, input=CHATTER, text=True, check=True)
    subprocess.run(["avr-objcopy", "-O", "ihex", elf, image], check=True)
    with running_board(OPTIBOOT, dtr=True) as board:
        assert rig_flash("--port", board.port, "--board", "uno", "--image", image) == 4
    assert capsys.readouterr().err.endswith(
        f"is not the firmware buzzer-board: put ours on it: rig-flash --port {board.port} "
        "--board uno (or nano, nano-old, mega)\n"
    )
