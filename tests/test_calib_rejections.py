"""What a result does not rest on is named, each with its reason, and only once."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from conftest import make_world, write_measured_session
from measured_rig import CHANNELS, Rig, make_rig
from room_sound import Scenario, make_room_sound, write_room_session

from calib.cli import command
from calib.corners import PoseCorners
from calib.emissions import accepted_rows, measure_tdoas
from calib.joint.session import answer_jointly
from calib.rejections import NOT_ACCEPTED, session_rejections
from calib.settings import Settings
from rigs.command import run
from rigs.session.reader import Session


def rejections(rig: Rig) -> list[tuple]:
    answer = answer_jointly(rig.description, rig.view(), rig.corners, rig.tdoas, CHANNELS, Settings())
    return [(each.kind, each.pose, each.buzzer, each.channel, each.reason) for each in answer.rejections]


def spoilt(rig: Rig, where: np.ndarray) -> Rig:
    off_s = np.random.default_rng(5).uniform(1e-4, 1e-3, where.shape) * where
    return replace(rig, arrival_s=rig.arrival_s + off_s)


def mask(rig: Rig, rows=slice(None), columns=slice(None)) -> np.ndarray:
    out = np.zeros(rig.arrival_s.shape, dtype=bool)
    out[rows, columns] = True
    return out


def test_good_measurements_are_all_used():
    assert all(kind == "arrival" for kind, *_ in rejections(make_rig(0)))
    assert len(rejections(make_rig(0))) < 4


def test_an_arrival_is_named_with_how_far_it_is_off():
    rig = make_rig(0)
    arrival_s = rig.arrival_s.copy()
    arrival_s[14, 5] += 1e-4
    named = [each for each in rejections(replace(rig, arrival_s=arrival_s)) if each[3] == 6]
    ((kind, pose, buzzer, channel, reason),) = named
    assert (kind, pose, buzzer, channel) == ("arrival", 2, 3, 6)
    assert float(reason.split()[0]) == pytest.approx(100, abs=5)


def test_what_only_a_channel_left_out_heard_along_is_not_rejected():
    """Two channels hear an emission, and one of them is left out: of the other alone nothing follows."""
    rig = make_rig(0, n_poses=8)
    arrival_s = rig.arrival_s.copy()
    arrival_s[14, 1:7] = np.nan
    heard = replace(rig, arrival_s=arrival_s)
    answer = answer_jointly(rig.description, rig.view(), rig.corners, heard.tdoas, CHANNELS[:7], Settings())
    assert not [each for each in answer.rejections if (each.pose, each.buzzer) == (2, 3)]


def test_a_whole_emission_a_pose_and_a_channel_are_named_once():
    rig = make_rig(1)
    ((_, pose, buzzer, *_),) = [
        each for each in rejections(spoilt(rig, mask(rig, 14, slice(0, 7)))) if each[0] == "emission"
    ]
    assert (pose, buzzer) == (2, 3)
    found = rejections(spoilt(rig, mask(rig, slice(12, 18))))
    assert [each[1] for each in found if each[0] == "pose"] == [2]
    assert not any(each[1] == 2 for each in found if each[0] != "pose")
    found = rejections(spoilt(rig, mask(rig, columns=3)))
    assert [each[3] for each in found if each[0] == "channel"] == [4]
    assert "of its" in next(each[4] for each in found if each[0] == "channel")
    assert not any(each[3] == 4 for each in found if each[0] == "arrival")


def test_what_the_sound_lacks_is_named(tmp_path):
    made = make_room_sound(Scenario(n_poses=2, seed=1, max_order=3))
    sound = made.sound.copy()
    sound[:, 2] = 0
    begin = int(made.expected_sample[7])
    sound[begin - 2000 : begin + 12000] = np.random.default_rng(0).normal(0, 1e-3, (14000, 8))
    with Session.open(write_room_session(tmp_path / "s1.h5", made.with_sound(sound))) as session:
        tdoas = measure_tdoas(session)
        corners = PoseCorners(np.array([0], dtype=np.int32), np.zeros((1, 54, 2)), {1: "the board was not found"})
        found = session_rejections(session, corners, tdoas)
        assert len(accepted_rows(session)) == 12
    assert [(each.channel, each.reason) for each in found if each.kind == "channel"] == [(3, "dead channel")]
    assert [(each.pose, each.reason) for each in found if each.kind == "pose"] == [(1, "the board was not found")]
    assert [(each.emission, each.pose, each.buzzer) for each in found if each.kind == "emission"] == [(7, 1, 2)]


def test_what_capture_did_not_accept_is_named(tmp_path, simulated_description):
    path = write_measured_session(tmp_path / "s1.h5", simulated_description)
    with h5py.File(path, "r+") as file:
        for name, row in (("emissions", 8), ("poses", 3)):
            table = file[name][:]
            table["accepted"][row] = 0
            file[name][:] = table
    with Session.open(path) as session:
        found = session_rejections(session, PoseCorners(np.arange(12), np.zeros((12, 54, 2))), measure_tdoas(session))
    assert [each.sentence() for each in found] == [
        f"pose 3: {NOT_ACCEPTED}",
        f"pose 1, emission 8, buzzer 3: {NOT_ACCEPTED}",
    ]


def test_file_and_screen_name_them(tmp_path, simulated_description, capsys):
    tdoa_s = make_world(n_poses=12, noise_s=1e-6).problem.tdoa_s
    for number in (*range(6, 12), 30):
        tdoa_s[number] += np.random.default_rng(number).uniform(-2e-3, 2e-3, 28)
    path = write_measured_session(tmp_path / "s1.h5", simulated_description, tdoa_s=tdoa_s)
    assert run("rig-calibrate", command, [str(path)]) == 0
    rejected = yaml.safe_load(Path(tmp_path / "s1.calib.yaml").read_text())["rejected"]
    assert set(rejected) == {"poses", "channels", "emissions", "arrivals"}
    assert [each["pose"] for each in rejected["poses"]] == [1]
    assert [(each["pose"], each["emission"], each["buzzer"]) for each in rejected["emissions"]] == [(5, 30, 1)]
    shown = capsys.readouterr().out
    assert "left out" in shown
    assert len(shown.splitlines()) < 60
