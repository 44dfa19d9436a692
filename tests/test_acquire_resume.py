"""A session that ended early goes on, and whatever happens meanwhile, the old file survives."""

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from capturing import Listener, captured, rig_text, small_description, small_rig

from acquire import capture as capturing
from acquire.capture import capture
from acquire.cli import cli
from acquire.errors import CaptureQualityError, DeviceError, DiskShortError, InterruptedCaptureError
from acquire.resume import look_into
from rigs.command import run
from rigs.errors import RigError
from rigs.session import layout
from rigs.session import recover as recovering
from rigs.session.journal import journal_path
from rigs.session.reader import Session
from rigs.session.writer import SessionWriter


def rig_capture(*arguments):
    return run("rig-capture", cli, [str(argument) for argument in arguments])


def resumed(path, seed=None, **options):
    earlier = look_into(path, None, seed)
    listener = Listener()
    capture(earlier.found, path, screen=listener, seed=earlier.seed, resumes=True, **options)
    return listener


@pytest.fixture(scope="module")
def two_poses(tmp_path_factory):
    path = tmp_path_factory.mktemp("two") / "s1.h5"
    captured(path, poses=2, seed=5)
    return path


@pytest.fixture(scope="module")
def four_poses(tmp_path_factory):
    path = tmp_path_factory.mktemp("four") / "s1.h5"
    captured(path, poses=4, seed=5)
    return path


@pytest.fixture
def path(two_poses, tmp_path):
    return Path(shutil.copy(two_poses, tmp_path / "s1.h5"))


@pytest.fixture
def cut_off(tmp_path):
    """Return a session as its killed writer leaves it, in the middle of its second pose."""
    there, here = tmp_path / "there" / "s1.h5", tmp_path / "here" / "s1.h5"
    there.parent.mkdir()
    here.parent.mkdir()
    append_emission = SessionWriter.append_emission

    def append_and_copy(writer, **fields):
        append_emission(writer, **fields)
        if fields["pose"] == 1:
            writer.flush()
            for each in (there, journal_path(there)):
                shutil.copy(each, here.parent)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SessionWriter, "append_emission", append_and_copy)
        captured(there, poses=2, seed=5)
    return here


def test_a_resumed_session_asks_for_the_poses_that_are_missing(path, four_poses):
    listener = resumed(path, poses=4)
    texts = [message.text for message in listener.messages]
    assert texts[0].startswith("resumed after ")
    assert "2 good poses of 2" in texts[0]
    assert texts[1] == "pose 3 of 4, board: move it to a new place and let it stand still"
    assert texts[-1].startswith("4 poses saved in ")
    with Session.open(path) as session, Session.open(four_poses) as whole:
        assert session.complete
        assert session.verify() == []
        assert session.poses[["pose", "accepted"]].tolist() == [(0, 1), (1, 1), (2, 1), (3, 1)]
        assert session.emissions["pose"].tolist() == whole.emissions["pose"].tolist()
        np.testing.assert_array_equal(session.truth.board_to_camera, whole.truth.board_to_camera)
        np.testing.assert_array_equal(session.truth.microphones_m, whole.truth.microphones_m)
        log = [line.decode() for line in session.log["text"]]
        assert "resumed with trigger simulated-board 1.0" in log
    assert [each.name for each in path.parent.iterdir()] == ["s1.h5"]


def test_the_first_new_block_is_flagged_and_what_was_there_is_as_it_was(path, two_poses):
    resumed(path, poses=3)
    with Session.open(path) as session, Session.open(two_poses) as old:
        flags = session.audio_blocks["flags"]
        n_old = len(old.audio_blocks)
        assert np.flatnonzero(flags).tolist() == [n_old]
        assert flags[n_old] == layout.FLAG_RESUMED
        assert session.audio_blocks[:n_old].tobytes() == old.audio_blocks.tobytes()
        assert session.emissions[: len(old.emissions)].tobytes() == old.emissions.tobytes()
        np.testing.assert_array_equal(session.picture(0), old.picture(0))


def test_the_board_is_where_the_truth_says(path, four_poses):
    """The third pose of a resumed session is that of one that was never broken off."""
    from rigs.board import find_corners

    resumed(path, poses=4)
    with Session.open(path) as session, Session.open(four_poses) as whole:
        for pose in (2, 3):
            corners = [
                find_corners(each.picture(int(np.flatnonzero(each.frames["pose"] == pose)[0])), each.description.board)
                for each in (session, whole)
            ]
            assert np.abs(corners[0] - corners[1]).max() < 1.0


def test_the_pose_under_way_is_stored_and_does_not_count(cut_off):
    resumed(cut_off, poses=3)
    with Session.open(cut_off) as session:
        assert session.complete
        assert session.verify() == []
        assert session.poses[["pose", "accepted"]].tolist() == [(0, 1), (1, 0), (2, 1), (3, 1)]
        assert set(session.emissions["pose"].tolist()) == {0, 1, 2, 3}
    assert [each.name for each in cut_off.parent.iterdir()] == ["s1.h5"]


class ComesBack:
    """Somebody who brings the board to the same place, whatever is asked for."""

    def __init__(self, operator, place):
        self._operator, self._place = operator, place

    def ask_for_pose(self, _pose):
        self._operator.ask_for_pose(self._place)


def at_place(place):
    """Return a choice of devices with such an operator."""
    choose_devices = capturing.choose_devices

    def choose(*args, **keys):
        rig = choose_devices(*args, **keys)
        return replace(rig, operator=ComesBack(rig.operator, place))

    return choose


@pytest.fixture(scope="module")
def two_hasty_poses(tmp_path_factory):
    path = tmp_path_factory.mktemp("hasty") / "s1.h5"
    captured(path, small_rig(capture={"poses": 2, "pose_timeout_s": 4}), seed=5)
    return path


@pytest.fixture
def impatient(two_hasty_poses, tmp_path):
    """Return a session of two poses, whose rig waits no longer than 4 s for the third."""
    return Path(shutil.copy(two_hasty_poses, tmp_path / "s1.h5"))


@pytest.mark.parametrize("place", [0, 1])
def test_every_place_from_before_is_known(impatient, place, monkeypatch):
    monkeypatch.setattr(capturing, "choose_devices", at_place(place))
    with pytest.raises(CaptureQualityError, match="where it was before: move the board to a place"):
        resumed(impatient, poses=3)


def test_a_place_is_known_by_any_of_its_pictures(impatient, monkeypatch):
    with Session.open(impatient) as session:
        first = session.frames[session.frames["pose"] == 0][0]
    with h5py.File(impatient, "r+") as file:
        del file[layout.CHECKSUMS]
        file[layout.CAMERA_STREAM][first["offset"] + first["length"] // 2] ^= 255
    monkeypatch.setattr(capturing, "choose_devices", at_place(0))
    with pytest.raises(CaptureQualityError, match="where it was before"):
        resumed(impatient, poses=3)


def test_a_place_whose_pose_no_longer_counts_may_be_captured_again(impatient, monkeypatch):
    with h5py.File(impatient, "r+") as file:
        del file[layout.CHECKSUMS]
        emissions = file[layout.EMISSIONS][:]
        file[layout.TIME_DATA][emissions["expected_sample"][emissions["pose"] == 1].min() :] = 0
    monkeypatch.setattr(capturing, "choose_devices", at_place(1))
    with pytest.raises(CaptureQualityError, match=r"pose 3 of 3: .*where it was before"):
        resumed(impatient, poses=3)
    with Session.open(impatient) as session:
        assert session.poses["accepted"].tolist() == [1, 0, 1]


def test_ctrl_c_while_copying_leaves_the_old_file(path):
    content = path.read_bytes()
    with pytest.raises(InterruptedCaptureError, match=r"interrupted before it went on: .*s1\.h5 is as it was"):
        resumed(path, poses=3, stop_wanted=lambda: True)
    left_alone(path, content)


def test_a_damaged_session_is_kept_under_another_name(cut_off):
    content = bytearray(cut_off.read_bytes())
    place = len(content) // 2
    content[place] ^= 1
    cut_off.write_bytes(content)
    listener = resumed(cut_off, poses=2)
    kept = cut_off.with_name("s1.before-resume-1.h5")
    assert kept.read_bytes() == bytes(content)
    assert journal_path(kept).exists()
    texts = [message.text for message in listener.messages]
    assert any(text.startswith("dropped: ") for text in texts)
    assert "the file as it was is kept as s1.before-resume-1.h5" in texts


def left_alone(path, content):
    assert path.read_bytes() == content
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_a_device_that_fails_at_once_leaves_the_old_file(path, monkeypatch):
    from acquire.devices.simulated.camera import SimulatedCamera

    def refuse(_):
        raise DeviceError("camera: is not there")

    content = path.read_bytes()
    monkeypatch.setattr(SimulatedCamera, "open", refuse)
    with pytest.raises(DeviceError):
        resumed(path, poses=3)
    left_alone(path, content)


def test_a_full_disk_is_told_before(path, monkeypatch):
    content = path.read_bytes()
    free = path.stat().st_size + 64_000_000  # room for the copy, but not for what comes after it
    monkeypatch.setattr(recovering.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9, free))
    with pytest.raises(DiskShortError, match=r"nearly full \(\d+ MB left, at least \d+ MB needed\)"):
        resumed(path, poses=3)
    left_alone(path, content)


def test_a_failure_while_copying_leaves_the_old_file(path, monkeypatch):
    def fail(*_, **__):
        raise KeyboardInterrupt

    content = path.read_bytes()
    monkeypatch.setattr(SessionWriter, "append_png", fail)
    with pytest.raises(KeyboardInterrupt):
        resumed(path, poses=3)
    left_alone(path, content)


def test_what_a_killed_resumption_left_is_cleared_away(path):
    path.with_name(".s1.h5.new").write_text("half a copy")
    resumed(path, poses=3)
    assert [each.name for each in path.parent.iterdir()] == ["s1.h5"]


def test_a_link_to_a_session_stays_one_and_its_journal_is_found(cut_off, tmp_path):
    link = tmp_path / "link.h5"
    link.symlink_to(cut_off)
    listener = resumed(link, poses=2)
    assert ", and pose 1 in part" in listener.messages[0].text
    assert link.is_symlink()
    with Session.open(cut_off) as session:
        assert session.complete
        assert session.poses["accepted"].sum() == 2
    assert [each.name for each in tmp_path.iterdir() if each.is_file()] == ["link.h5"]


def test_a_session_that_has_all_poses_is_refused(path, capsys):
    assert rig_capture("--session", path, "--resume", "--poses", 2) == 2
    assert "has 2 good poses already: ask for more with --poses" in capsys.readouterr().err


def test_another_rig_is_refused_and_the_difference_named(path, tmp_path, capsys):
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig_text(small_description(signal={"gap_s": 0.2})), encoding="utf-8")
    content = path.read_bytes()
    assert rig_capture("--session", path, "--resume", "--rig", rig, "--poses", 3) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"not the rig of {path}: signal.gap_s is 0.2, in the session 0.15" in error
    assert path.read_bytes() == content


def test_the_same_rig_with_another_comment_is_taken(path, tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"# mine\n{small_rig().text}", encoding="utf-8")
    assert rig_capture("--session", path, "--resume", "--rig", rig, "--poses", 3) == 0


def test_a_device_at_another_address_is_the_same_one_and_noted(path, tmp_path, capsys):
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig_text(small_description(trigger={"port": "/dev/ttyACM1"})), encoding="utf-8")
    assert rig_capture("--session", path, "--resume", "--rig", rig, "--poses", 3) == 0
    line = "trigger.port is now '/dev/ttyACM1', it was 'auto'"
    assert line in capsys.readouterr().out
    with Session.open(path) as session:
        assert line.encode() in session.log["text"]
        assert session.poses["accepted"].sum() == 3


@pytest.mark.parametrize(("section", "key", "value"), [("camera", "source", "/dev/video2"), ("audio", "device", None)])
def test_camera_and_sound_device_may_have_another_address(path, section, key, value):
    named = small_rig(**{section: {key: value or {"name": "the same"}}})
    description = look_into(path, named, None).found.description
    assert getattr(getattr(description, section), key) == getattr(getattr(named.description, section), key)


def test_a_device_that_is_missing_names_the_way_to_another_address(path, monkeypatch):
    from acquire.devices.simulated.trigger import SimulatedTrigger

    def refuse(_):
        raise DeviceError("/dev/ttyACM0: there is no such port")

    monkeypatch.setattr(SimulatedTrigger, "open", refuse)
    with pytest.raises(DeviceError, match=r"no such port; if it has another address now, .*: --resume --rig"):
        resumed(path, poses=3)


def test_how_many_poses_were_wanted_is_remembered(tmp_path, capsys):
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig_text(small_description()), encoding="utf-8")
    assert rig_capture("--session", tmp_path / "s1", "--rig", rig, "--poses", 1) == 0
    assert rig_capture("--session", tmp_path / "s1", "--resume") == 2
    assert "has 1 good poses already" in capsys.readouterr().err
    assert rig_capture("--session", tmp_path / "s1", "--resume", "--poses", 2) == 0
    with Session.open(tmp_path / "s1.h5") as session:
        assert session.versions["poses wanted"] == "2"


def test_another_seed_is_refused(path, capsys):
    assert rig_capture("--session", path, "--resume", "--seed", 6) == 2
    assert "began with --seed 5, so it cannot go on with --seed 6" in capsys.readouterr().err


def test_a_session_that_begins_with_measurements_cannot_go_on(tmp_path, capsys):
    path, found = tmp_path / "s1.h5", small_rig()
    columns, rows = found.description.board.corners
    with SessionWriter.create(
        path,
        name="s1",
        description_text=found.text,
        n_channels=len(found.description.audio.recorded_channels()),
        sample_rate_hz=found.description.audio.sample_rate_hz,
        versions={},
        corners_px=np.zeros((1, columns * rows, 2)),
    ) as writer:
        writer.append_pose(pose=0, start_host_time_s=0.0, end_host_time_s=1.0, accepted=True)
    content = path.read_bytes()
    assert rig_capture("--session", path, "--resume") == 2
    assert "begins with measured corners or TDOAs" in capsys.readouterr().err
    left_alone(path, content)


def test_a_session_that_is_not_there_cannot_go_on(tmp_path, capsys):
    assert rig_capture("--session", tmp_path / "s1", "--resume") == 5
    assert "no such file" in capsys.readouterr().err


def test_an_existing_session_names_resume(path, capsys):
    assert rig_capture("--session", path) == 2
    assert capsys.readouterr().err.endswith("choose another name, or go on with that session: --resume\n")


@pytest.mark.parametrize("name", ["s2.h5", "link.h5"])
def test_a_session_that_is_being_recorded_cannot_go_on(path, name):
    living = path.with_name("s2.h5")
    path.with_name("link.h5").symlink_to(living)
    with (
        Session.open(path) as session,
        SessionWriter.create(
            living,
            name="s2",
            description_text=session.description_text,
            n_channels=session.n_channels,
            sample_rate_hz=session.sample_rate_hz,
            versions={},
        ),
        pytest.raises(RigError, match="another program still records into it"),
    ):
        look_into(path.with_name(name), None, None)
