"""The good part of a damaged session is copied, and what is lost is said; the damaged file is not touched."""

import os
import shutil
import signal
import subprocess
import sys
import weakref
from pathlib import Path

import h5py
import numpy as np
import pytest
from example_sessions import TRUTH, add_frame_and_emission, measured, new_session, picture, samples, write_session

from rigs.cli import cli
from rigs.command import run
from rigs.errors import DamagedSessionError, SessionError, TargetError, TargetExistsError
from rigs.interruption import interrupted_between_steps
from rigs.session import layout
from rigs.session import recover as recovering
from rigs.session.damaged import lookup3
from rigs.session.journal import journal_path, read_journal, record
from rigs.session.reader import Session
from rigs.session.recover import recover
from rigs.session.wreck import Wreck

BLOCK = 1024
PER_POSE = 6  # blocks: the sweep of 0.1 s fits in


def add_pose(writer, pose):
    for block in range(PER_POSE):
        writer.append_audio(samples(PER_POSE * pose + block, BLOCK), host_time_s=pose + 0.1 * block, adc_time_s=0.5)
    add_frame_and_emission(writer, pose, expected_sample=PER_POSE * BLOCK * pose)


def end_pose(writer, pose):
    writer.append_pose(pose=pose, start_host_time_s=pose + 0.1, end_host_time_s=pose + 0.9, accepted=True)


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Return a folder with s.h5 and its journal as a killed writer leaves them: 20 poses, and one under way."""
    folder, there = tmp_path_factory.mktemp("killed"), tmp_path_factory.mktemp("living")
    with new_session(there / "s.h5", truth=TRUTH) as writer:
        for pose in range(20):
            add_pose(writer, pose)
            end_pose(writer, pose)
        writer.append_log(3.0, "info", "twenty")
        add_pose(writer, 20)
        writer.flush()
        for each in there.iterdir():
            shutil.copy(each, folder)
    return folder


@pytest.fixture
def wreck(killed, tmp_path):
    shutil.copytree(killed, tmp_path, dirs_exist_ok=True)
    return tmp_path / "s.h5"


def without_journal(path):
    journal_path(path).unlink()
    return path


def spoiled(path, place, n_bytes=1):
    content = bytearray(path.read_bytes())
    content[place : place + n_bytes] = bytes(255 - byte for byte in content[place : place + n_bytes])
    path.write_bytes(content)
    return path


def place_of(path, block):
    return path.read_bytes().index(samples(block, BLOCK)[100:110].tobytes())


@pytest.mark.parametrize("has_journal", [True, False])
def test_a_killed_session_is_whole_but_for_the_pose_under_way(wreck, has_journal):
    if not has_journal:
        without_journal(wreck)
    recovery = recover(wreck, wreck.with_name("new.h5"))
    assert recovery.dropped == []
    assert (recovery.n_accepted, recovery.n_poses, recovery.under_way, recovery.next_pose) == (20, 21, 20, 21)
    with Session.open(wreck.with_name("new.h5")) as session:
        assert session.complete
        assert session.recovered == "from s.h5"
        assert session.verify() == []
        assert session.n_samples == 21 * PER_POSE * BLOCK
        assert session.poses[-1].tolist() == (20, 20.2, 20.3, 0)
        assert session.emissions["accepted"].all()
        assert (session.audio_blocks["flags"] == 0).all()
        np.testing.assert_array_equal(session.audio(5 * BLOCK, BLOCK), samples(5, BLOCK))
        np.testing.assert_array_equal(session.picture(20), picture(20))
        np.testing.assert_array_equal(session.truth.microphones_m, TRUTH.microphones_m)
        assert session.log["text"][0] == b"twenty"
        assert session.log["text"][1].startswith(b"recovered from s.h5: ")
    assert not list(wreck.parent.glob("*new*.journal")) + list(wreck.parent.glob(".*"))


def test_the_damaged_file_and_its_journal_are_not_touched(wreck):
    before = [(each.read_bytes(), each.stat().st_mtime_ns) for each in (wreck, journal_path(wreck))]
    recover(wreck, wreck.with_name("new.h5"))
    assert before == [(each.read_bytes(), each.stat().st_mtime_ns) for each in (wreck, journal_path(wreck))]


@pytest.mark.parametrize("has_journal", [True, False])
def test_a_damaged_block_becomes_silence_of_its_length(wreck, has_journal):
    spoiled(wreck, place_of(wreck, 13))
    if not has_journal:
        without_journal(wreck)
    recovery = recover(wreck, wreck.with_name("new.h5"))
    assert recovery.dropped == [
        "0.02 s of damaged sound, now silence: at 0.28 s",
        "1 emissions count no longer: their sound is damaged or lost",
    ]
    with Session.open(wreck.with_name("new.h5")) as session:
        assert session.verify() == []
        assert not session.audio(13 * BLOCK, BLOCK).any()
        np.testing.assert_array_equal(session.audio(14 * BLOCK, BLOCK), samples(14, BLOCK))
        assert np.flatnonzero(session.audio_blocks["flags"]).tolist() == [13]
        assert session.audio_blocks["flags"][13] == layout.FLAG_SILENCED
        assert np.flatnonzero(session.emissions["accepted"] == 0).tolist() == [2]
        assert np.flatnonzero(session.poses["accepted"] == 0).tolist() == [20]  # pose 2 has its picture


def test_a_damaged_picture_is_dropped(wreck):
    spoiled(wreck, wreck.read_bytes().index(b"IDAT") + 9)
    recovery = recover(wreck, wreck.with_name("new.h5"))
    assert recovery.dropped == ["1 damaged or lost frames"]
    with Session.open(wreck.with_name("new.h5")) as session:
        assert len(session.frames) == 20
        assert session.verify() == []


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("has_journal", [True, False])
def test_a_truncated_file_keeps_its_beginning(wreck, share, has_journal):
    n_bytes = int(share * wreck.stat().st_size)
    os.truncate(wreck, n_bytes)
    if not has_journal:
        without_journal(wreck)
    recovery = recover(wreck, wreck.with_name("new.h5"))
    with Session.open(wreck.with_name("new.h5")) as session:
        assert session.verify() == []
        n_there = n_bytes // (BLOCK * session.n_channels * 4)
        assert len(session.audio_blocks) > 0.8 * min(n_there, 126) - 20
        for block in range(len(session.audio_blocks)):
            np.testing.assert_array_equal(session.audio(block * BLOCK, BLOCK), samples(block, BLOCK))
        good = session.emissions["accepted"] != 0
        assert (session.emissions["expected_sample"][good] + 4800 <= session.n_samples).all()
    assert recovery.dropped
    assert recovery.n_accepted <= recovery.duration_s / (PER_POSE * BLOCK / 48000) + 1


def test_a_truncated_complete_session_keeps_its_beginning(tmp_path):
    path = tmp_path / "s.h5"
    with new_session(path) as writer:
        for pose in range(20):
            add_pose(writer, pose)
            end_pose(writer, pose)
    os.truncate(path, path.stat().st_size // 2)
    with pytest.raises(DamagedSessionError, match="HDF5 cannot open it"):
        Session.open(path)
    assert 3 <= recover(path, tmp_path / "new.h5").n_accepted < 20


def test_the_journal_alone_finds_everything_where_the_index_is_torn(wreck):
    spoiled(wreck, 0, 4096)
    with pytest.raises(SessionError):
        Session.open(wreck)
    recovery = recover(wreck, wreck.with_name("new.h5"))
    assert (recovery.n_frames, recovery.n_accepted, recovery.dropped) == (21, 20, [])


def test_a_torn_journal_counts_as_far_as_it_is_whole(wreck):
    spoiled(wreck, 8, 40)
    journal = journal_path(wreck)
    os.truncate(journal, journal.stat().st_size - 7)
    recovery = recover(wreck, wreck.with_name("new.h5"))
    assert 10 <= recovery.n_accepted < 20


def test_a_journal_of_another_file_is_ignored(wreck, tmp_path):
    (tmp_path / "other").mkdir()
    with new_session(tmp_path / "other" / "s.h5") as writer:
        writer.flush()
        shutil.copy(journal_path(tmp_path / "other" / "s.h5"), journal_path(wreck))
    assert recover(wreck, wreck.with_name("new.h5")).n_accepted == 20


def test_a_foreign_journal_is_none(tmp_path):
    for content in (b"", b"hello", record({"a": np.zeros(3)}), b"RIGJ" + bytes(8)):
        (tmp_path / "j").write_bytes(content)
        assert read_journal(tmp_path / "j") is None


def test_a_good_session_is_copied_whole(tmp_path):
    path = write_session(tmp_path / "s.h5", truth=TRUTH, **measured())
    assert recover(path, tmp_path / "new.h5").dropped == []
    with Session.open(path) as old, Session.open(tmp_path / "new.h5") as new:
        for table in ("frames", "emissions", "poses"):
            assert getattr(old, table)["pose"].tolist() == getattr(new, table)["pose"].tolist()
        assert (
            old.audio_blocks.tobytes() == new.audio_blocks.tobytes() or np.isnan(old.audio_blocks["adc_time_s"]).all()
        )
        np.testing.assert_array_equal(old.corners_px, new.corners_px)
        np.testing.assert_array_equal(old.tdoas.tdoa_s, new.tdoas.tdoa_s)
        assert (old.created_utc, old.name, old.versions) == (new.created_utc, new.name, new.versions)


def without_checksums(path, change):
    """Change a closed session as another program would, or an older one would have made it."""
    with h5py.File(path, "r+") as file:
        del file[layout.CHECKSUMS]
        change(file)


def test_onsets_go_with_the_emissions_that_remain(tmp_path):
    path = write_session(tmp_path / "s.h5", n_poses=3)
    without_checksums(path, lambda file: file[layout.EMISSIONS].resize(4, axis=0))
    recover(path, tmp_path / "new.h5")
    with h5py.File(path) as old, h5py.File(tmp_path / "new.h5") as new:
        assert (len(old[layout.ONSETS]), len(new[layout.ONSETS]), len(new[layout.EMISSIONS])) == (6, 4, 4)
        assert new[layout.ONSETS][:].tobytes() == old[layout.ONSETS][:4].tobytes()
        for table in (layout.PINGS, layout.CLOCK_FITS):
            assert new[table][:].tobytes() == old[table][:].tobytes()
    with Session.open(tmp_path / "new.h5") as session:
        assert session.verify() == []


@pytest.mark.parametrize("n_onsets", [None, 1])
def test_emissions_without_an_onset_have_one_that_is_not_known(tmp_path, n_onsets):
    def lose_onsets(file):
        if n_onsets is None:
            del file[layout.ONSETS]
        else:
            file[layout.ONSETS].resize(n_onsets, axis=0)

    path = write_session(tmp_path / "s.h5", n_poses=2)
    without_checksums(path, lose_onsets)
    recover(path, tmp_path / "new.h5")
    with Session.open(tmp_path / "new.h5") as session:
        assert len(session.onsets) == len(session.emissions) == 4
        for field in session.onsets.dtype.names:
            assert np.flatnonzero(np.isnan(session.onsets[field])).tolist() == list(range(n_onsets or 0, 4))
        assert session.verify() == []


def test_the_copy_shows_how_far_it_is(wreck):
    watched = []

    def watch(rows, what):
        for row in rows:
            watched.append(what)
            yield row

    recovery = recover(wreck, wreck.with_name("new.h5"), watch)
    assert watched == ["copying sound"] * 21 * PER_POSE + ["copying pictures"] * recovery.n_frames


def test_nothing_is_written_over(wreck):
    wreck.with_name("new.h5").write_text("precious")
    with pytest.raises(TargetExistsError):
        recover(wreck, wreck.with_name("new.h5"))
    with pytest.raises(TargetExistsError):
        recover(wreck, wreck)
    assert wreck.with_name("new.h5").read_text() == "precious"


def test_a_session_that_is_being_recorded_is_left_alone(tmp_path):
    with new_session(tmp_path / "s.h5") as writer:
        writer.flush()
        with pytest.raises(SessionError, match="another program still records into it"):
            recover(tmp_path / "s.h5", tmp_path / "new.h5")


def test_a_full_disk_is_told_before(wreck, monkeypatch):
    monkeypatch.setattr(recovering.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9, 10))
    with pytest.raises(TargetError, match=r"this disk has 0\.00 GB free"):
        recover(wreck, wreck.with_name("new.h5"))
    assert sorted(each.name for each in wreck.parent.iterdir()) == ["s.h5", "s.h5.journal"]


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89HDF\r\n\x1a\n", b"\x89HDF\r\n\x1a\n\x03" + bytes(4000)])
def test_what_is_no_session_is_refused_in_one_line(tmp_path, capsys, content):
    (tmp_path / "s.h5").write_bytes(content)
    assert run("rig-session", cli, ["recover", str(tmp_path / "s.h5"), "-o", str(tmp_path / "new.h5")]) == 5
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "nothing can be recovered" in error
    assert not (tmp_path / "new.h5").exists()


def test_scrambled_files_never_crash(wreck):
    content = wreck.read_bytes()
    rng = np.random.default_rng(0)
    for number in range(25):
        scrambled = bytearray(content)
        for place in rng.integers(0, 20000, 10):
            scrambled[place] ^= int(rng.integers(1, 256))
        wreck.write_bytes(scrambled)
        recovery = recover(wreck, wreck.with_name(f"{number}.h5"))
        assert recovery.n_frames >= 18
        with Session.open(wreck.with_name(f"{number}.h5")) as session:
            assert session.verify() == []


def test_the_command_tells_what_was_kept_and_dropped(wreck, capsys):
    spoiled(wreck, place_of(wreck, 13))
    assert run("rig-session", cli, ["recover", str(wreck), "-o", str(wreck.with_name("new.h5"))]) == 0
    printed = capsys.readouterr().out
    assert "kept     2.7 s of sound, 21 frames, 21 emissions, 20 good poses of 21, and pose 20 in part" in printed
    assert "dropped  0.02 s of damaged sound, now silence: at 0.28 s" in printed
    assert run("rig-session", cli, ["info", str(wreck.with_name("new.h5"))]) == 0
    assert "recovered  from s.h5" in capsys.readouterr().out


@pytest.fixture
def ctrl_c():
    """See that Ctrl-C is heard: it is ignored where a script runs the tests in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_ctrl_c_is_not_lost_in_a_callback(wreck):
    """An exception in a weak reference's callback goes nowhere: HDF5's objects die at any time."""

    class Dying:
        pass

    def watch(rows, what):
        for row in rows:
            dying = Dying()
            reference = weakref.ref(dying, lambda _: signal.raise_signal(signal.SIGINT))
            del dying
            yield row
            assert reference() is None

    with pytest.raises(KeyboardInterrupt):
        recover(wreck, wreck.with_name("new.h5"), watch)
    assert sorted(each.name for each in wreck.parent.iterdir()) == ["s.h5", "s.h5.journal"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_in_the_last_step_is_not_lost():
    with pytest.raises(KeyboardInterrupt), interrupted_between_steps():
        signal.raise_signal(signal.SIGINT)


def test_a_journal_that_another_session_left_is_not_believed(wreck, tmp_path):
    other = tmp_path / "other.h5"
    with new_session(other) as writer:
        add_pose(writer, 7)
        end_pose(writer, 7)
        writer.flush()
        shutil.copy(journal_path(other), journal_path(wreck))
    with Session.open(wreck) as session:
        poses = session.poses["pose"].tolist()
    with Wreck.open(wreck) as found:
        assert found.tables[layout.POSES]["pose"].tolist() == poses


def test_last_poses_without_pictures_count_no_longer(tmp_path):
    path = tmp_path / "s.h5"
    with new_session(path) as writer:
        for pose in range(4):
            add_pose(writer, pose)
            end_pose(writer, pose)
    content = path.read_bytes()
    with Session.open(path) as session:
        places = [content.index(session._png(row).tobytes()) for row in np.flatnonzero(session.frames["pose"] >= 2)]
    for place in places:
        spoiled(path, place + 60)
    recovery = recover(path, tmp_path / "new.h5")
    assert recovery.n_accepted == 2
    assert any(line.startswith("2 poses at the end count no longer") for line in recovery.dropped)


def test_a_copy_without_a_good_pose_is_no_success(tmp_path, capsys):
    path = tmp_path / "s.h5"
    with new_session(path) as writer:
        add_pose(writer, 0)
    assert run("rig-session", cli, ["recover", str(path), "-o", str(tmp_path / "new.h5")]) == 5
    assert "without a good pose, nothing to calibrate from" in capsys.readouterr().out


def test_a_folder_is_no_session(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("rig-session", cli, ["recover", ".", "-o", "new.h5"]) == 5
    assert ".: a folder: name a session file" in capsys.readouterr().err


def test_checksums_are_those_of_hdf5(tmp_path):
    with h5py.File(tmp_path / "s.h5", "w", libver=("v110", "v110")):
        pass
    head = (tmp_path / "s.h5").read_bytes()[:48]
    assert lookup3(head[:44]).to_bytes(4, "little") == head[44:]


_GROWING = """
import resource, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from rigs.session.recover import recover
recover(Path({path!r}), Path({target!r}))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def test_memory_does_not_grow_with_the_session(wreck):
    big = wreck.with_name("big.h5")
    with new_session(big) as writer:
        for block in range(60):
            writer.append_audio(np.full((48000, 8), block, dtype=np.float32), host_time_s=0.0, adc_time_s=0.0)

    def peak_kb(path):
        code = _GROWING.format(tests=str(Path(__file__).parent), path=str(path), target=str(path) + ".copy.h5")
        return int(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)

    assert peak_kb(big) - peak_kb(wreck) < 40_000 < big.stat().st_size / 1024
