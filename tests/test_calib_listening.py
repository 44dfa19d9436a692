"""Around the arrivals: the cache beside the session, the look at one emission, and memory."""

import os
import shutil
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import write_measured_session
from room_sound import RoomSound, Scenario, make_room_sound, write_room_session

from calib.cache import ArrivalCache
from calib.cli import command
from calib.emissions import accepted_rows, measure_tdoas
from calib.inspection import View
from calib.sound import SoundArrivals, find_arrivals
from calib.sound_report import sound_report
from rigs.cli import cli
from rigs.command import run
from rigs.session.reader import Session


@pytest.fixture(scope="module")
def made() -> RoomSound:
    return make_room_sound(Scenario(n_poses=2, seed=1, max_order=3))


@pytest.fixture
def path(made, tmp_path) -> Path:
    return write_room_session(tmp_path / "s1.h5", made)


@pytest.fixture
def session(path):
    with Session.open(path) as opened:
        yield opened


def cache_of(session: Session) -> ArrivalCache:
    return ArrivalCache(session.path, session.sha256())


def refuse_to_listen(monkeypatch) -> None:
    def listen(*_):
        raise AssertionError("listened again")

    monkeypatch.setattr("calib.emissions.find_arrivals", listen)


def test_a_second_run_takes_the_arrivals_of_the_first(session, monkeypatch):
    before = session.path.read_bytes()
    first = measure_tdoas(session, "auto", cache_of(session))
    assert session.path.read_bytes() == before
    refuse_to_listen(monkeypatch)
    second = measure_tdoas(session, "auto", cache_of(session))
    np.testing.assert_array_equal(first.tdoa_s, second.tdoa_s)
    np.testing.assert_array_equal(first.sound.std_s, second.sound.std_s)
    assert first.warnings == second.warnings
    assert sound_report(session, first.sound) == sound_report(session, second.sound)


def test_flaws_survive_the_cache(made, tmp_path, monkeypatch):
    sound = made.sound.copy()
    sound[:, 2] = 0
    with Session.open(write_room_session(tmp_path / "s2.h5", made.with_sound(sound))) as session:
        first = measure_tdoas(session, "auto", cache_of(session))
        refuse_to_listen(monkeypatch)
        second = measure_tdoas(session, "auto", cache_of(session))
    assert first.sound.flaws.counts() == second.sound.flaws.counts() == {"dead channel": 12}
    assert first.warnings == second.warnings != []


def test_the_cache_is_of_one_sound_and_one_setting(session):
    cache, rows = cache_of(session), accepted_rows(session)
    cache.save(find_arrivals(session, rows, "auto"), "auto")
    assert cache.load(rows, "auto") is not None
    assert cache.load(rows, "gcc-phat") is None
    assert cache.load(rows[1:], "auto") is None
    assert ArrivalCache(session.path, "another").load(rows, "auto") is None


@pytest.mark.parametrize("damage", [b"", b"precious notes", b"PK\x03\x04 cut"])
def test_a_file_that_is_no_cache_is_left_alone(session, damage):
    cache, rows = cache_of(session), accepted_rows(session)
    cache.path.write_bytes(damage)
    assert cache.load(rows, "auto") is None
    measure_tdoas(session, "auto", cache)
    assert cache.path.read_bytes() == damage


def test_a_cut_off_cache_is_not_believed(session):
    cache, rows = cache_of(session), accepted_rows(session)
    measure_tdoas(session, "auto", cache)
    whole = cache.path.read_bytes()
    for n in range(0, len(whole), 97):
        cache.path.write_bytes(whole[:n])
        assert cache.load(rows, "auto") is None


def test_a_damaged_cache_is_not_believed(session):
    cache, rows = cache_of(session), accepted_rows(session)
    first = measure_tdoas(session, "auto", cache).sound
    whole = cache.path.read_bytes()
    for place in range(0, len(whole), 17):
        cache.path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x5A]) + whole[place + 1 :])
        loaded = cache.load(rows, "auto")
        assert loaded is None or np.array_equal(loaded.arrival_s, first.arrival_s, equal_nan=True)


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is read-only for root")
def test_a_read_only_folder_does_without(session):
    session.path.parent.chmod(0o500)
    try:
        assert np.isfinite(measure_tdoas(session, "auto", cache_of(session)).tdoa_s).all()
    finally:
        session.path.parent.chmod(0o700)


@pytest.mark.parametrize("mode", ["auto", "gcc-phat"])
def test_an_emission_can_be_looked_at(path, tmp_path, capsys, mode):
    assert run("rig-calibrate", command, [str(path), "--inspect-tdoa", "3", "--tdoa", mode]) == 0
    said = capsys.readouterr().out
    assert "emission 3, pose 0, buzzer 4" in said
    assert said.count("kept") >= 8
    assert path.with_suffix(".emission-3.png").read_bytes().startswith(b"\x89PNG")
    assert not path.with_suffix(".calib.yaml").exists()


def test_a_look_says_why_an_emission_was_left_out(made, tmp_path, capsys):
    labels = [made.description.signal.waveform().label()] * len(made.pose)
    labels[4] = "something else"
    path = write_room_session(tmp_path / "s3.h5", made, labels)
    target = tmp_path / "look.svg"
    assert run("rig-calibrate", command, [str(path), "--inspect-tdoa", "4", "-o", str(target)]) == 0
    assert "rejected: wrong waveform" in capsys.readouterr().out
    assert "wrong waveform" in target.read_text()
    assert "candidates" in target.read_text()


def test_an_emission_that_does_not_count_can_be_looked_at(path, tmp_path, capsys):
    rejected = tmp_path / "s4.h5"
    shutil.copy(path, rejected)
    with h5py.File(rejected, "r+") as file:
        rows = file["emissions"][()]
        rows["accepted"][3] = 0
        file["emissions"][...] = rows
    assert run("rig-calibrate", command, [str(rejected), "--inspect-tdoa", "3"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "does not count: not good at capture" in said
    assert run("rig-session", cli, ["info", "--emissions", str(rejected)]) == 0
    lines = [line.split(maxsplit=6) for line in capsys.readouterr().out.splitlines()]
    numbered = {line[0]: line for line in lines if line and line[0].isdigit()}
    assert "not good at capture" in " ".join(numbered["3"])
    assert numbered["2"][-1].strip().endswith("yes")


def test_ripples_of_a_peak_are_no_candidates():
    lag_ms = np.linspace(-2, 2, 401)
    paths = [np.exp(-(((lag_ms - place) / 0.05) ** 2)) for place in (-1.0, 0.5)]
    row = paths[0] + 0.6 * paths[1] + 0.15 * np.exp(-(((lag_ms + 0.85) / 0.02) ** 2))
    nothing = np.full(1, np.nan)
    view = View("", "matched", (1,), lag_ms, row[None], lag_ms, row[None], nothing, nothing[:, None], nothing, [""])
    np.testing.assert_allclose(lag_ms[view.candidates(0)], [-1.0, 0.5])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["99"], "there is no emission 99, they go from 0 to "), (["1", "-o", "a.txt"], "a .png or an .svg")],
)
def test_what_cannot_be_looked_at_is_said(path, capsys, arguments, words):
    assert run("rig-calibrate", command, [str(path), "--inspect-tdoa", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_measured_tdoas_have_no_sound_to_look_at(tmp_path, simulated_description, capsys):
    path = write_measured_session(tmp_path / "s.h5", simulated_description)
    assert run("rig-calibrate", command, [str(path), "--inspect-tdoa", "0"]) == 2
    assert "no sound" in capsys.readouterr().err


@pytest.mark.parametrize("mode", ["matched", "gcc-phat"])
def test_memory_does_not_grow_with_the_session(path, mode):
    """Four times as many emissions of the same sound."""

    def peak_bytes(n_times: int) -> int:
        with Session.open(path) as session:
            session.emissions = np.tile(session.emissions, n_times)
            tracemalloc.start()
            find_arrivals(session, np.arange(len(session.emissions)), mode)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            return peak

    peak_bytes(2)  # caches are filled
    assert peak_bytes(48) < 1.1 * peak_bytes(12)


def test_arrivals_say_what_they_are(session):
    sound = find_arrivals(session, accepted_rows(session), "auto")
    assert isinstance(sound, SoundArrivals)
    report = sound_report(session, sound)
    assert report["tdoa"] == "matched"
    assert report["n_left_out"] == 0
    assert report["quality"] == 1
    assert report["channels"] == report["emissions"] == []
    assert 0 < report["arrival_std_s"] < 1e-6
