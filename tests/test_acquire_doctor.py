"""rig-check: each fault of the simulated bench, of the real board and of missing devices is named, with its remedy."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
import yaml
from capturing import rig_text, small_description
from rich.console import Console
from scripted_board import HELLO, ScriptedBoard
from simboard import running_board

from acquire.devices.choose import choose_devices
from acquire.devices.simulated.microphones import SimulatedMicrophones
from acquire.devices.simulated.trigger import SimulatedTrigger
from acquire.doctor.checkup import check_up
from acquire.doctor.cli import cli
from acquire.doctor.hearing import Hearing
from acquire.doctor.row import Part, Row, State, exit_code, refusal
from acquire.doctor.table import LiveTable, hearing_table
from acquire.errors import DeviceError, DeviceRestartedError, FirmwareError
from rigs.command import run
from rigs.library import FoundDescription
from rigs.session.layout import FLAG_OVERFLOW

SIX_BUZZERS = [
    {"id": 1 + 3 * row + column, "position_m": (-0.045 + 0.145 * column, -0.045 + 0.215 * row, -0.005)}
    for row in range(2)
    for column in range(3)
]
MEASURED = {Part.DEVICES, Part.PICTURE, Part.SOUND}  # the computer is busy with other tests


def checked(folder, description):
    """Return the rows about the bench, and the hearing."""
    findings = list(check_up(description, folder, seed=0))
    rows = [finding for finding in findings if isinstance(finding, Row) and finding.part in MEASURED]
    assert all(row.remedy for row in rows if row.state is not State.OK)
    return rows, next((finding for finding in findings if isinstance(finding, Hearing)), None)


def faults(rows):
    return {(row.subject, row.state.value) for row in rows if row.state is not State.OK}


def with_fault(kind, **keys):
    return small_description(simulation={"faults": [{"kind": kind, **keys}]})


def test_a_good_bench_is_green_and_each_microphone_hears_each_buzzer(tmp_path):
    rows, hearing = checked(tmp_path, small_description())
    assert faults(rows) == set()
    assert exit_code(rows) == 0
    assert hearing.level_dbfs.shape == hearing.snr_db.shape == (8, 2)
    assert hearing.heard().all()
    assert hearing.snr_db.min() > 30
    assert hearing.level_dbfs.max() < -20
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("kind", "keys", "named", "code"),
    [
        ("dead_channel", {"channel": 3}, {("channel 3", "bad")}, 5),
        ("loud_channel", {"channel": 3}, {("channel 3", "bad")}, 5),
        ("weak_channel", {"channel": 3}, {("channel 3", "look")}, 0),
        ("noisy_channel", {"channel": 3}, {("channel 3", "look")}, 0),
        ("humming_channel", {"channel": 3}, {("channel 3", "look")}, 0),
        ("inverted_channel", {"channel": 3}, {("channel 3", "look")}, 0),
        ("duplicate_channel", {"channel": 3}, {("channels 3, 4", "bad")}, 5),
        ("silent_buzzer", {"buzzer": 7}, {("buzzer 7", "bad")}, 5),
        ("blurred", {}, {("focus", "bad")}, 5),
        ("overexposed", {}, {("exposure", "bad")}, 5),
        ("camera_lost", {}, {("camera", "bad")}, 3),
        ("audio_lost", {}, {("sound device", "bad")}, 3),
        ("trigger_lost", {}, {("trigger board", "bad")}, 3),
        ("audio_overflow", {}, {("samples", "look")}, 0),
    ],
)
def test_a_fault_is_named_and_nothing_else(tmp_path, kind, keys, named, code):
    rows, _ = checked(tmp_path, with_fault(kind, **keys))
    assert faults(rows) == named
    assert exit_code(rows) == code


@pytest.mark.parametrize("kind", ["camera_lost", "audio_lost", "trigger_lost"])
def test_a_missing_device_does_not_hide_the_others(tmp_path, kind):
    rows, hearing = checked(tmp_path, with_fault(kind))
    good = {row.subject for row in rows if row.state is State.OK}
    assert (
        good
        >= {
            "camera_lost": {"trigger board", "sound device", "microphones", "latency"},
            "audio_lost": {"trigger board", "camera", "board", "exposure", "focus"},
            "trigger_lost": {"camera", "board", "sound device", "sample rate"},
        }[kind]
    )
    assert (hearing is None) == (kind == "audio_lost")


def test_swapped_channels_are_named_where_places_are_expected(tmp_path):
    board = {"buzzers": SIX_BUZZERS, "buzzer_std_m": 0.0001}  # of two buzzers some pairs of microphones are equally far
    truth_m = choose_devices(small_description(), seed=0).truth.microphones_m
    roughly_m = truth_m + 0.02 * np.random.default_rng(0).standard_normal(truth_m.shape)
    audio = {"expected_positions_m": [tuple(place) for place in roughly_m.round(3).tolist()]}
    rows, _ = checked(tmp_path, small_description(audio=audio, board=board))
    assert next(row.state for row in rows if row.subject == "order") is State.OK
    fault = {"faults": [{"kind": "swapped_channel", "channel": 5}]}
    rows, _ = checked(tmp_path, small_description(audio=audio, board=board, simulation=fault))
    assert faults(rows) == {("order", "bad")}
    assert "channels 5, 6 hear as if swapped" in next(row.finding for row in rows if row.subject == "order")
    rows, _ = checked(tmp_path, small_description(board=board, simulation=fault))
    assert faults(rows) == set()  # any order is the right one for some array


def test_the_sync_output_is_no_microphone(tmp_path):
    rows, hearing = checked(tmp_path, small_description(audio={"sync_channel": 9}))
    assert hearing.channels == tuple(range(1, 9))
    assert faults(rows) == set()
    assert next(row.state for row in rows if row.subject == "sync output") is State.OK
    rows, _ = checked(
        tmp_path,
        small_description(audio={"sync_channel": 9}, simulation={"faults": [{"kind": "dead_channel", "channel": 9}]}),
    )
    assert faults(rows) == {("sync output", "look")}


def test_no_board_in_the_picture(tmp_path):
    board = {"corners": (10, 7)}
    description = small_description()
    other = description.model_copy(update={"board": description.board.model_copy(update=board)})
    findings = []
    with pytest.MonkeyPatch.context() as patch:  # the scene still shows the board of 9 x 6 corners
        patch.setattr("acquire.doctor.checkup.choose_devices", lambda _, seed: choose_devices(description, seed=seed))
        findings, hearing = checked(tmp_path, other)
    assert faults(findings) == {("board", "bad")}
    assert hearing.heard().all()


def test_the_real_firmware_is_named(tmp_path):
    with running_board() as board:
        rows, hearing = checked(
            tmp_path,
            small_description(
                trigger={"driver": "serial", "port": board.port},
                board={"buzzers": [{"id": 2, "position_m": (0.0, -0.045, 0.0)}]},
            ),
        )
    firmware = next(row for row in rows if row.subject == "firmware")
    assert firmware.finding.startswith("buzzer-board 1.")
    assert firmware.finding.endswith("on uno")
    assert hearing.buzzers == (2,)
    assert hearing.heard().sum() >= 7  # a starved simulated board may cost one


def test_a_board_that_restarts_before_it_is_to_play_is_no_lost_board(tmp_path):
    buzzers = [{"id": number, "position_m": (0.05 * number, -0.045, 0.0)} for number in (1, 2)]
    with running_board() as board:
        description = small_description(
            trigger={"driver": "serial", "port": board.port}, board={"buzzers": buzzers}, signal={"gap_s": 0.15}
        )
        findings = []
        for finding in check_up(description, tmp_path, seed=0):
            if str(finding).startswith("listening"):
                board.reset()
            findings.append(finding)
    assert next(each for each in findings if isinstance(each, Hearing)).buzzers == (1, 2)
    rows = [each for each in findings if isinstance(each, Row)]
    assert ("trigger board", "bad") not in faults(rows)


def test_a_foreign_firmware_is_exit_code_4(tmp_path):
    with ScriptedBoard(hello=HELLO.replace("buzzer-board", "grbl")) as board:
        rows, _ = checked(tmp_path, small_description(trigger={"driver": "serial", "port": board.port}))
    assert faults(rows) == {("firmware", "bad")}
    assert exit_code(rows) == 4
    assert "rig-flash" in next(row.remedy for row in rows if row.subject == "firmware")


def test_a_board_that_comes_back_with_another_firmware_does_not_hide_the_rest(tmp_path, monkeypatch):
    def restarted(*_):
        raise DeviceRestartedError("/dev/ttyX: the board restarted: check its cable")

    def foreign(_board):
        raise FirmwareError("/dev/ttyX: the firmware there is grbl: run rig-flash")

    def lost_while_it_plays(finding):
        if str(finding).startswith("listening"):
            monkeypatch.setattr(SimulatedTrigger, "play", restarted)
            monkeypatch.setattr(SimulatedTrigger, "open", foreign)
        return finding

    rows = [lost_while_it_plays(each) for each in check_up(small_description(), tmp_path, seed=0)]
    rows = [each for each in rows if isinstance(each, Row)]
    assert ("trigger board", "bad") in faults(rows)
    assert exit_code(rows) == 4
    assert {row.part for row in rows} == set(Part)


def test_sound_lost_between_two_buzzers_is_told_and_no_fault_of_the_channels(tmp_path, monkeypatch):
    read, n_played, n_lost = SimulatedMicrophones.read, [], []
    play = SimulatedTrigger.play

    def counted(board, *arguments):
        n_played.append(board)
        return play(board, *arguments)

    def lossy(microphones):
        for block in read(microphones):
            if len(n_played) == 1 and sum(n_lost) < 0.2 * 48000:
                n_heard.append(len(block.samples))
                if sum(n_heard) > 0.3 * 48000:  # the first has sounded
                    n_lost.append(len(block.samples))
                    continue
            yield replace(block, flags=FLAG_OVERFLOW) if n_lost and not n_told else block
            n_told.extend(n_lost)

    n_heard, n_told = [], []
    monkeypatch.setattr(SimulatedTrigger, "play", counted)
    monkeypatch.setattr(SimulatedMicrophones, "read", lambda microphones: list(lossy(microphones)))
    rows, hearing = checked(tmp_path, small_description(audio={"sample_rate_hz": 48000}))
    assert sum(n_lost) >= 0.2 * 48000
    assert len(n_played) == 2
    assert faults(rows) == {("samples", "look")}
    np.testing.assert_allclose(hearing.onset_s, 0.003, atol=0.003)


def test_every_missing_device_has_its_row(tmp_path):
    description = small_description(
        trigger={"driver": "serial", "port": "/dev/ttyNONE"},
        camera={"driver": "opencv", "source": str(tmp_path / "none.avi")},
        audio={"driver": "portaudio", "device": {"name": "no such device"}},
    )
    rows, _ = checked(tmp_path, description)
    assert faults(rows) == {("trigger board", "bad"), ("camera", "bad"), ("sound device", "bad")}
    assert exit_code(rows) == 3


def test_a_folder_that_cannot_be_written_to(tmp_path):
    rows = [finding for finding in check_up(small_description(), tmp_path / "none") if isinstance(finding, Row)]
    folder = next(row for row in rows if row.subject == "folder")
    assert folder.state is State.BAD
    assert folder.remedy


def test_a_session_that_does_not_fit_on_the_disk(tmp_path, monkeypatch):
    monkeypatch.setattr("acquire.doctor.computer.session_bytes", lambda _: 1e18)
    rows = [finding for finding in check_up(small_description(), tmp_path) if isinstance(finding, Row)]
    assert next(row.state for row in rows if row.subject == "disk") is State.BAD


@pytest.mark.parametrize(
    ("message", "finding", "remedy"),
    [
        ("/dev/ttyX: no such port: plug it in: now", "/dev/ttyX: no such port", "plug it in: now"),
        ("trigger board: lost: check its cable", "lost", "check its cable"),
        ("no board found: plug it in; ports here: none", "no board found", "plug it in; ports here: none"),
        ("audio: not open; open it first", "not open", "open it first"),
        ("gone", "gone", "check its cable, and its section in the rig description"),
    ],
)
def test_a_refusal_is_split_into_finding_and_remedy(message, finding, remedy):
    row = refusal("device", DeviceError(message))
    assert (row.finding, row.remedy, row.exit_code) == (finding, remedy, 3)


def rig_check(tmp_path, monkeypatch, *arguments, **sections):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text(rig_text(small_description(**sections)))
    return run("rig-check", cli, list(arguments))


def test_the_command_prints_one_line_a_row_into_a_pipe(tmp_path, monkeypatch, capsys):
    faults = [{"kind": "dead_channel", "channel": 3}]
    assert rig_check(tmp_path, monkeypatch, simulation={"faults": faults}) == 5
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "rig test, from rig.yaml"
    assert [line for line in lines if line.startswith("  bad")] == [
        (
            "  bad  channel 3       dead: it delivers one constant value; do: check its cable, power and mute switch, "
            "and that audio.channels names an input that is there"
        )
    ]
    assert re.fullmatch(r"not ready: mend 1 of \d+ \(channel 3\), then run rig-check again", lines[-1])
    table = [line.split() for line in lines if line.startswith(" " * 5)]
    assert [line[0] for line in table] == ["channel", *"12345678"]
    assert table[3][1:] == ["none", "-", "-"]


def test_the_table_of_six_buzzers_fits_seventy_columns():
    figures = np.full((8, 6), -94.0)
    tables = {"level_dbfs": figures, "snr_db": -figures / 8, "onset_s": figures, "clipped": figures > 0}
    hearing = Hearing(
        channels=tuple(range(1, 9)),
        buzzers=tuple(range(1, 7)),
        noise_dbfs=np.full(8, -90.0),
        sample_rate_hz=48000.0,
        **tables,
    )
    console = Console(file=StringIO(), width=70)
    console.print(hearing_table(hearing))
    lines = console.file.getvalue().splitlines()
    assert lines[0].split() == ["channel", "noise", *(word for buzzer in range(1, 7) for word in ("bz", str(buzzer)))]
    assert len(lines) == 9
    assert "…" not in "".join(lines)


def test_the_last_line_names_what_is_to_be_mended_and_of_many_the_first(capsys):
    table = LiveTable(FoundDescription("", small_description(), "rig.yaml", "--rig"), Console(highlight=False))
    for channel in range(1, 7):
        table.add(Row(Part.SOUND, f"channel {channel}", State.BAD, "dead", "check it"))
    table.end()
    assert capsys.readouterr().out.splitlines()[-1] == (
        "not ready: mend 6 of 6 (channel 1, channel 2, channel 3, channel 4, 2 more), then run rig-check again"
    )


def test_json_holds_the_same_for_a_machine(tmp_path, monkeypatch, capsys):
    faults = [{"kind": "silent_buzzer", "buzzer": 7}]
    assert rig_check(tmp_path, monkeypatch, "--json", simulation={"faults": faults}) == 5
    said = json.loads(capsys.readouterr().out)
    assert said["exit_code"] == 5
    assert [(row["subject"], row["exit_code"]) for row in said["rows"] if row["state"] == "bad"] == [("buzzer 7", 5)]
    assert np.array(said["hearing"]["snr_db"], dtype=float).shape == (8, 2)
    assert said["hearing"]["snr_db"][0][1] is None


def test_a_wrong_description_is_exit_code_2(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"name": "x"}))
    assert run("rig-check", cli, []) == 2
    assert "rig.yaml" in capsys.readouterr().err


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from acquire.doctor.cli import cli; from rigs.command import run; run('rig-check', cli, ['-h']);"
        "sys.exit(','.join({'cv2', 'h5py', 'scipy', 'numpy', 'pydantic', 'rich', 'yaml'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stderr.strip() == ""
    assert "Exit code: 0 nothing bad" in done.stdout


def test_the_exit_code_is_that_of_what_has_to_be_mended_first():
    bad = [Row(Part.DEVICES, "x", State.BAD, "broken", "mend it", exit_code=code) for code in (5, 4, 3)]
    looked_at = Row(Part.SOUND, "x", State.LOOK, "so so", "look")
    assert exit_code([looked_at]) == 0
    assert [exit_code([looked_at, *bad[:n]]) for n in (1, 2, 3)] == [5, 4, 3]


def test_signal_to_noise_ratio_and_level_follow_the_room(tmp_path):
    quiet, loud = (checked(tmp_path, small_description(simulation={"snr_db": snr_db}))[1] for snr_db in (40, 20))
    assert quiet.snr_db - loud.snr_db == pytest.approx(20, abs=1.5)  # the noise is drawn anew
    assert loud.noise_dbfs - quiet.noise_dbfs == pytest.approx(20, abs=0.2)
    assert quiet.level_dbfs == pytest.approx(loud.level_dbfs, abs=0.2)


def test_digital_silence_on_all_microphones_is_named(tmp_path):
    dead = [{"kind": "dead_channel", "channel": channel} for channel in range(1, 9)]
    rows, _ = checked(tmp_path, small_description(simulation={"faults": dead}))
    [row] = [row for row in rows if row.state is State.BAD]
    assert (row.subject, row.finding) == ("microphones", "all deliver digital silence")
