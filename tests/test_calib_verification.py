"""Verification at the level of corners and arrivals: where sounds are located, what is expected, what has moved."""

from dataclasses import replace

import numpy as np
import pytest
from measured_rig import CHANNELS, make_rig
from verified_rig import calibrated, calibrated_rig, checked, met_again, one_moved

from calib.measurements import Measurements
from calib.verification.heldout import calibrate_without, held_out_poses, settings_of
from calib.verification.location import Heard, Speed, locate
from calib.verification.movement import WHOLE_ARRAY
from calib.verification.verdict import Limits, judge
from rigs.geometry import rotation_matrix

SEEDS = range(6)


@pytest.fixture(scope="module")
def rigs():
    """Return some rigs with their calibrations: the slow part."""
    return [calibrated_rig(seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def unmoved(rigs):
    return [checked(calibration, met_again(rig, seed)) for seed, (rig, calibration) in enumerate(rigs)]


def test_sound_lies_on_its_buzzer(unmoved):
    errors_px = [np.median(each.comparison.error_px) for each in unmoved]
    errors_m_per_m = [np.median(each.comparison.error_m / each.comparison.distance_m) for each in unmoved]
    assert np.median(errors_px) <= 1.5
    assert np.median(errors_m_per_m) <= 0.003
    assert all(each.located.found.all() for each in unmoved)


def test_errors_are_as_large_as_expected(unmoved):
    """Errors that a session's emissions share make each session a single draw; together they must agree."""
    squares = np.concatenate([each.comparison.deviation**2 for each in unmoved])
    assert 0.3 < squares.mean() / 2 < 2.0
    ratio = np.sqrt(np.mean([np.mean(each.comparison.error_m**2) for each in unmoved])
                    / np.mean([np.mean(each.comparison.expected_m**2) for each in unmoved]))  # fmt: skip
    assert 0.4 < ratio < 1.5


def test_nothing_moved_raises_no_alarm(unmoved):
    assert [each.moved for each in unmoved] == [[] for _ in SEEDS]
    assert all(each.movement.resolution_m < 0.0015 for each in unmoved)


def test_the_microphone_that_moved_is_named(rigs):
    for seed, (rig, calibration) in enumerate(rigs):
        channel, shifts_m = one_moved(seed)
        found = checked(calibration, met_again(rig, seed, shifts_m=shifts_m)).movement.motions
        assert found[0].channel == channel
        error_m = np.linalg.norm(found[0].shift_m - shifts_m[channel - 1])
        assert error_m < 4 * np.sqrt(np.trace(found[0].covariance_m2))


def test_two_that_moved_are_named(rigs):
    rig, calibration = rigs[0]
    shifts_m = np.zeros((8, 3))
    shifts_m[[1, 5]] = [(0.003, 0.0, 0.0), (0.0, 0.0, -0.004)]
    assert checked(calibration, met_again(rig, 0, shifts_m=shifts_m)).moved == [2, 6]


def test_the_whole_array_moved_against_the_camera(rigs):
    for seed, (rig, calibration) in enumerate(rigs[:3]):
        found = checked(calibration, met_again(rig, seed, shifts_m=np.array([0.003, -0.002, 0.002])))
        assert found.moved == [WHOLE_ARRAY]
        assert "the whole array by" in found.movement.motions[0].sentence()


def test_an_array_that_was_turned(rigs):
    rig, calibration = rigs[0]
    turn = rotation_matrix(np.radians([0.0, 0.4, 0.0]))
    places_m = rig.truth.microphones_m
    found = checked(calibration, met_again(rig, 0, shifts_m=places_m @ turn.T - places_m))
    assert found.moved == [WHOLE_ARRAY]
    assert found.movement.motions[0].turn_deg == pytest.approx(0.4, abs=0.05)


def test_a_poor_calibration_is_no_motion():
    """Eight poses calibrate, many verify: the difference is the calibration's own uncertainty."""
    for seed in range(3):
        rig = make_rig(seed, n_poses=8)
        assert checked(calibrated(rig), met_again(rig, seed, n_poses=40)).movement.motions == []


def test_held_out_poses_take_no_part_in_the_calibration(rigs):
    rig, calibration = rigs[0]
    measured = Measurements(rig.description, rig.corners, rig.tdoas, settings_of(calibration, rig.description))
    held_out = held_out_poses(rig.corners.pose)
    spoilt_s = rig.arrival_s + 1e-4 * np.isin(rig.pose, held_out)[:, None] * np.arange(8)
    corners_px = rig.corners_px + 5.0 * np.isin(rig.corners.pose, held_out)[:, None, None]
    other = replace(rig, arrival_s=spoilt_s, corners_px=corners_px)
    plain, spoilt = (
        calibrate_without(replace(measured, tdoas=each.tdoas, corners=each.corners), held_out, calibration)
        for each in (rig, other)
    )
    assert 0.3 < len(held_out) / len(rig.corners.pose) < 0.35
    np.testing.assert_allclose(plain.positions_m, spoilt.positions_m, atol=1e-6)  # OpenCV sums in any order


def test_a_few_poses_are_enough(rigs):
    rig, calibration = rigs[1]
    channel, shifts_m = one_moved(1)
    assert checked(calibration, met_again(rig, 1, n_poses=4, shifts_m=shifts_m)).moved == [channel]


def test_one_pose_cannot_tell(rigs):
    rig, calibration = rigs[0]
    found = checked(calibration, met_again(rig, 0, n_poses=1))
    assert found.movement.motions == []
    assert found.movement.doubt
    assert found.located.found.all()


def test_a_wild_arrival_does_no_harm(rigs):
    rig, calibration = rigs[2]
    again = met_again(rig, 2)
    wild_s = again.arrival_s.copy()
    wild_s[:, 3] += 5e-4
    plain, spoilt = checked(calibration, again), checked(calibration, replace(again, arrival_s=wild_s))
    assert spoilt.located.found.all()
    assert np.median(spoilt.comparison.error_px) < 2 * np.median(plain.comparison.error_px) + 0.5


def test_sounds_that_few_heard_are_not_located(rigs):
    rig, calibration = rigs[0]
    again = met_again(rig, 0)
    arrival_s = again.arrival_s.copy()
    arrival_s[:12, :4] = np.nan
    found = checked(calibration, replace(again, arrival_s=arrival_s))
    assert found.located.found.sum() == len(arrival_s) - 12
    assert not found.located.found[:12].any()
    verdict = judge(found.located, found.comparison, found.movement, Limits())
    assert any("could be located" in failure for failure in verdict.failures)


def test_the_speed_of_sound_of_the_day_is_found(rigs):
    rig, calibration = rigs[0]
    again = met_again(rig, 0)
    heard = Heard(calibration.positions_m, calibration.array_covariance_m2, again.arrival_s, again.std_s)
    located = locate(heard, Speed(343.2, 2.0))
    assert located.speed.m_s == pytest.approx(again.truth.speed_m_s, abs=0.6)
    assert len(CHANNELS) == heard.arrival_s.shape[1]


def test_what_cannot_be_seen_is_not_passed_as_unmoved(unmoved):
    one = unmoved[0].movement
    assert one.unseen(one.resolution_m) == ""
    assert f"up to {1e3 * one.resolution_m:.1f} mm unseen" in one.unseen(0.9 * one.resolution_m)


def test_each_microphone_has_its_own_smallest_motion(unmoved):
    one = unmoved[0].movement
    assert tuple(one.resolutions_m) == CHANNELS
    assert one.resolution_m == max(one.resolutions_m.values())


def test_exchanged_plugs_are_no_motion(rigs):
    rig, calibration = rigs[0]
    again = met_again(rig, 0)
    order = [0, 1, 2, 4, 3, 5, 6, 7]
    found = checked(calibration, replace(again, arrival_s=again.arrival_s[:, order], std_s=again.std_s[:, order]))
    assert found.movement.swapped == [(4, 5)]
    (failure, *_) = judge(found.located, found.comparison, found.movement, Limits()).failures
    assert failure.startswith("channels 4 and 5 look swapped")
    assert "array moved" not in failure


def test_another_rigs_calibration_is_said_to_be_one(rigs):
    (rig, _), (_, other) = rigs[:2]
    shifts_m = 0.01 * np.random.default_rng(0).standard_normal((8, 3))
    foreign = replace(other, positions_m=rigs[0][1].positions_m + shifts_m)
    found = checked(foreign, met_again(rig, 0))
    (failure, *_) = judge(found.located, found.comparison, found.movement, Limits()).failures
    assert failure.startswith("this looks like another rig's calibration")
    assert f"the focal length {np.mean(other.intrinsics.focal_px):.1f} px there" in failure
    lengths_mm = [float(words.split()[-1]) for words in failure.split(" mm;")[0].split("microphone ")[1].split(",")]
    assert len(lengths_mm) == 8
    assert lengths_mm == sorted(lengths_mm, reverse=True)


def test_a_dead_microphone_leaves_the_others_checked(rigs):
    rig, calibration = rigs[0]
    again = met_again(rig, 0)
    arrival_s = np.where(np.arange(8) == 2, np.nan, again.arrival_s)
    found = checked(calibration, replace(again, arrival_s=arrival_s))
    assert sorted(found.movement.resolutions_m) == [1, 2, 4, 5, 6, 7, 8]


def test_limits_decide(unmoved):
    one = unmoved[0]
    assert judge(one.located, one.comparison, one.movement, Limits()).passed
    assert not judge(one.located, one.comparison, one.movement, Limits(error_deg=1e-4)).passed
