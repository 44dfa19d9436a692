"""Which serial port is meant, and what is said when none is, or when it does not open."""

import pytest

from acquire.errors import DeviceError
from acquire.ports import FoundPort, choose_port, flash_command, open_port, serial_ports

UNO = FoundPort("/dev/ttyACM0", "2341:0043", "75830303934351618291")
OTHER_UNO = FoundPort("/dev/ttyACM1", "2341:0043", "A1")
NANO = FoundPort("/dev/ttyUSB0", "1A86:7523")
STRANGE = FoundPort("/dev/ttyUSB1", "1234:ABCD", "7")
BUILT_IN = FoundPort("/dev/ttyS0")


@pytest.mark.parametrize(
    ("wanted", "ports", "chosen"),
    [
        ("auto", [BUILT_IN, UNO, STRANGE], UNO),
        ("auto", [BUILT_IN, STRANGE], STRANGE),
        ("2341:0043", [UNO, NANO], UNO),
        ("1a86:7523", [UNO, NANO], NANO),
        ("2341:0043:A1", [UNO, OTHER_UNO], OTHER_UNO),
        ("1234:abcd:7", [UNO, STRANGE], STRANGE),
        ("/dev/ttyACM1", [UNO, OTHER_UNO], OTHER_UNO),
        ("/dev/pts/7", [UNO], FoundPort("/dev/pts/7")),
        ("COM3", [UNO], FoundPort("COM3")),
    ],
)
def test_the_port_that_is_meant_is_chosen(wanted, ports, chosen):
    assert choose_port(wanted, ports) == chosen


def test_a_link_to_a_port_keeps_its_name_and_gains_its_ids(tmp_path):
    (tmp_path / "port").write_text("")
    (tmp_path / "board").symlink_to(tmp_path / "port")
    listed = FoundPort(str(tmp_path / "port"), "2341:0042")
    assert choose_port(str(tmp_path / "board"), [listed]) == FoundPort(str(tmp_path / "board"), "2341:0042")


@pytest.mark.parametrize(
    ("wanted", "ports", "said"),
    [
        ("auto", [], r"no board found on any USB port: plug the board in .* ports here: none"),
        ("auto", [BUILT_IN], r"no board found .* ports here: /dev/ttyS0 \(no USB ids\)"),
        (
            "auto",
            [UNO, NANO],
            r"2 boards could be meant: .* /dev/ttyACM0 \(2341:0043:7583.*, Arduino Uno\); /dev/ttyUSB0",
        ),
        ("2341:0043", [UNO, OTHER_UNO], r"2 boards could be meant"),
        ("2341:0043:B2", [UNO, NANO], r"no device with the USB ids 2341:0043:B2: .* CH340"),
    ],
)
def test_no_board_and_several_boards_are_told_apart(wanted, ports, said):
    with pytest.raises(DeviceError, match=said):
        choose_port(wanted, ports)


def test_ids_tell_the_board_only_where_they_can():
    assert (UNO.board, NANO.board, STRANGE.board, BUILT_IN.board) == ("uno", "", "", "")
    assert FoundPort("/dev/ttyACM0", "2341:0042").board == "mega"
    assert STRANGE.describe() == "/dev/ttyUSB1 (1234:ABCD:7, unknown USB device)"


def test_the_command_that_flashes_a_port_names_the_board_where_the_ids_do_not(monkeypatch):
    monkeypatch.setattr("acquire.ports.serial_ports", lambda: [UNO, NANO])
    assert flash_command(UNO.path) == "rig-flash --port /dev/ttyACM0"
    for path in (NANO.path, "/dev/pts/7"):
        assert flash_command(path) == f"rig-flash --port {path} --board uno (or nano, nano-old, mega)"


def test_the_ports_of_this_computer_are_listed_in_order():
    paths = [port.path for port in serial_ports()]
    assert paths == sorted(paths)


def test_a_missing_port_is_named_with_those_that_are_there(tmp_path):
    with pytest.raises(DeviceError, match=r"ttyNO: there is no such port: plug the board in, .* ports here: "):
        open_port(str(tmp_path / "ttyNO"))


def test_a_file_is_no_port(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(DeviceError, match=r"file: cannot be opened as a serial port \(.*\): name the port"):
        open_port(str(tmp_path / "file"))
