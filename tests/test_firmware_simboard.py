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
        write = [*flash, "-U", f"flash:w:{image}:i"]
        run = subprocess.run(write, capture_output=True, text=True, timeout=120, check=False)
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


def said_by(*arguments: object) -> list[str]:
    """Return the lines that the simulated board says when it refuses to start."""
    with start(*arguments) as board:
        _, said = board.communicate(timeout=10)
    assert board.returncode == 2
    return said.splitlines()


def test_an_image_that_is_not_there_or_for_another_chip_is_refused_in_one_line(tmp_path):
    missing, mega, uno = tmp_path / "no.elf", firmware("mega"), firmware()
    assert said_by(missing) == [f"simboard: {missing}: No such file or directory"]
    assert said_by(mega) == [f"simboard: {mega}: this image is not for an ATmega328P: give --mcu atmega2560"]
    assert said_by("--mcu", "atmega2560", uno) == [
        f"simboard: {uno}: this image is not for an ATmega2560: leave out --mcu"
    ]


def test_firmware_that_runs_wild_is_told_in_a_few_lines():
    with start("--fast", firmware("mega", "hex")) as board:  # a hex file does not tell its chip
        _, said = board.communicate(timeout=60)
    assert board.returncode == 1
    lines = said.splitlines()
    assert len(lines) < 10
    assert lines[-1].startswith("simboard: the firmware crashed at address 0x")
    assert lines[-1].endswith("; if it is not for an atmega328p, give --mcu")


def test_a_link_replaces_nothing_of_others(tmp_path):
    file, link = tmp_path / "file", tmp_path / "ttyBOARD"
    file.write_text("precious")
    assert said_by("--link", file, firmware()) == [
        f"simboard: {file}: is there already, and is not a link to a port: give another --link"
    ]
    assert file.read_text() == "precious"
    with start("--link", link, firmware()) as board:
        port = board.stdout.readline().strip()
        (line,) = said_by("--link", link, firmware())
        assert line.startswith(f"simboard: {link}: leads to a port that is there: end the simulated board that made it")
        assert link.resolve() == Path(port)
        link.unlink()
        link.symlink_to(file)  # somebody else's by now
        board.send_signal(signal.SIGTERM)
        assert board.wait(timeout=10) == 0
    assert link.resolve() == file


def test_the_link_of_a_board_that_was_killed_is_taken_over(tmp_path):
    link = tmp_path / "ttyBOARD"
    link.symlink_to(tmp_path / "gone")
    with start("--link", link, firmware()) as board:
        port = board.stdout.readline().strip()
        assert link.resolve() == Path(port)
        board.send_signal(signal.SIGTERM)
        assert board.wait(timeout=10) == 0
    assert not link.is_symlink()
