"""The simulated board itself: that it behaves like the real one on the desk."""

import signal
import subprocess
import time
from pathlib import Path

import serial
from simboard import BUILD, OPTIBOOT, Talk, firmware, make, running_board


def start(*arguments: object) -> subprocess.Popen[str]:
    make("simboard")
    words = [str(word) for word in (BUILD / "simboard", *arguments)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_link_leads_to_the_port_and_is_gone_when_the_board_is(tmp_path):
    link = tmp_path / "ttyBOARD"
    with start("--link", link, firmware()) as board:
        port = board.stdout.readline().strip()
        assert link.resolve() == Path(port)
        board.send_signal(signal.SIGTERM)
        assert board.wait(timeout=10) == 0
    assert not link.is_symlink()


def test_an_image_that_is_none_is_refused_in_one_line(tmp_path):
    for name, content in (("no.hex", "hello"), ("no.elf", "hello")):
        path = tmp_path / name
        path.write_text(content)
        with start(path) as board:
            _, said = board.communicate(timeout=10)
        assert board.returncode == 2
        assert str(path) in said
    with start() as board:
        assert "usage" in board.communicate(timeout=10)[1]
    assert board.returncode == 2


def test_opening_the_port_resets_a_board_as_dtr_does():
    with running_board(dtr=True) as board:
        for _ in range(2):
            with Talk(board.port) as host:
                while host.next_boot()["reset"] == "power":  # may just have been on its way
                    pass
                assert host.ask("1 status")["reset"] == "external"
        time.sleep(0.1)  # the trace is written every 5 ms
        assert [cause for _, cause in board.trace().resets] == ["power", "external", "external"]


def test_a_board_as_bought_is_flashed_through_its_real_boot_loader():
    image = firmware("uno", "hex")
    with running_board(OPTIBOOT, dtr=True) as board:
        flash = ["avrdude", "-p", "atmega328p", "-c", "arduino", "-b", "115200", "-P", board.port, "-D"]
        run = subprocess.run([*flash, "-U", f"flash:w:{image}:i"], capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
        assert "verified" in run.stderr
        with Talk(board.port) as host:  # resets it again; the sketch is still there
            host.next_boot()
            assert host.ask("1 hello")["name"] == "buzzer-board"
            assert host.play("2 play 1 tone 1000 5000")


def test_a_board_without_a_sketch_waits_for_one():
    with running_board(OPTIBOOT) as board, serial.Serial(board.port, timeout=10) as line:
        time.sleep(1.5)  # past the boot loader's patience
        line.reset_input_buffer()
        board.reset()
        time.sleep(0.1)
        line.write(b"0 ")  # "are you there", in the boot loader's language
        assert line.read(2) == b"\x14\x10"
