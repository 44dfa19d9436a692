"""The disk's part: syncs hold up nobody, come in the right order, and a disk that refuses is told of."""

import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from example_sessions import N_CHANNELS, RIG, TEXT, add_pose, new_session

from rigs.errors import SessionWriteError, TargetExistsError
from rigs.session import durability
from rigs.session.journal import journal_path, read_journal
from rigs.session.layers import Header
from rigs.session.reader import Session
from rigs.session.writer import SessionWriter


@pytest.fixture
def path(tmp_path):
    return tmp_path / "s.h5"


def test_a_disk_that_is_slow_to_sync_holds_up_nobody(path, monkeypatch):
    began, may_end = threading.Event(), threading.Event()

    def slow(descriptor):
        began.set()
        assert may_end.wait(60)
        os.fsync(descriptor)

    monkeypatch.setattr(durability, "_sync", slow)
    with new_session(path) as writer:
        writer.append_log(0.0, "info", "first")
        writer.flush()
        assert began.wait(60)
        for pose in range(20):  # would never come back if it waited for the sync
            add_pose(writer, pose)
            writer.flush()
        with Session.open(path) as session:
            assert len(session.poses) == 20
        assert len(read_journal(journal_path(path)).tables["poses"]) == 20
        may_end.set()
    assert not journal_path(path).exists()


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_the_file_is_synced_before_its_journal(path, monkeypatch):
    synced = []

    def noted(descriptor):
        synced.append(".journal" in str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        os.fsync(descriptor)

    monkeypatch.setattr(durability, "_sync", noted)
    with new_session(path) as writer:
        add_pose(writer, 0)
        writer.flush()
    assert synced[:2] == [False, True]


def test_a_disk_that_refuses_to_sync_is_told_of_and_the_file_reads(path, monkeypatch):
    failed = threading.Event()

    def refuse(_):
        failed.set()
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(durability, "_sync", refuse)
    writer = new_session(path)
    add_pose(writer, 0)
    writer.flush()
    assert failed.wait(60)

    def go_on():
        for pose in range(1, 1000):
            add_pose(writer, pose)
            writer.flush()

    with pytest.raises(SessionWriteError, match=r"cannot be written \(Input/output error\)"):
        go_on()
    writer.close()
    monkeypatch.undo()
    with Session.open(path) as session:
        assert len(session.poses) >= 1
        assert session.verify() == []


def test_a_copy_is_on_the_disk_before_it_takes_the_place_of_the_old_file(path, monkeypatch):
    new_session(path).close()
    done = []

    def slow(descriptor):
        time.sleep(0.2)
        os.fsync(descriptor)
        done.append("synced")

    replace = Path.replace
    monkeypatch.setattr(durability, "_sync", slow)
    monkeypatch.setattr(Path, "replace", lambda *paths: (done.append("replaced"), replace(*paths)))
    header = Header("s", TEXT, {}, float(RIG.audio.sample_rate_hz))
    with SessionWriter.begin(path, header, N_CHANNELS) as writer:
        add_pose(writer, 0)
        writer.replace(keep=False)
        assert done == ["synced", "synced", "replaced", "replaced"]  # file and journal each


def test_a_copy_that_another_program_makes_is_left_alone(path):
    header = Header("s", TEXT, {}, float(RIG.audio.sample_rate_hz))
    with SessionWriter.begin(path, header, N_CHANNELS) as writer:
        with pytest.raises(TargetExistsError, match="another program is making this session"):
            SessionWriter.begin(path, header, N_CHANNELS)
        add_pose(writer, 0)
        writer.publish()
    with Session.open(path) as session:
        assert session.complete
        assert session.verify() == []


def test_the_journal_holds_what_was_flushed(path):
    with new_session(path) as writer:
        for pose in range(3):
            add_pose(writer, pose)
            writer.flush()
        journal = read_journal(journal_path(path))
        with Session.open(path) as session:
            for name, table in (
                ("poses", session.poses),
                ("emissions", session.emissions),
                ("camera/frames", session.frames),
            ):
                np.testing.assert_array_equal(journal.tables[name], table)
            assert journal.text("file_id")
