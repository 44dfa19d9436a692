"""The accuracy that was promised, on rooms by an independent simulator."""

from pathlib import Path

import numpy as np
import pytest
from room_sound import RoomSound, Scenario, make_room_sound, write_room_session

from calib.emissions import EmissionTdoas, measure_tdoas
from calib.flaws import Flaw
from rigs.session.reader import Session


def measured(folder: Path, made: RoomSound, mode="auto") -> EmissionTdoas:
    with Session.open(write_room_session(folder / "s.h5", made)) as session:
        return measure_tdoas(session, mode)


def errors_s(made: RoomSound, tdoas: EmissionTdoas) -> np.ndarray:
    """Return the errors of all TDOAs that were not rejected."""
    first, second = (tdoas.pairs - 1).T
    errors = np.abs(tdoas.tdoa_s - (made.arrival_s[:, second] - made.arrival_s[:, first]))
    return errors[np.isfinite(errors)]


def deviations_s(made: RoomSound, tdoas: EmissionTdoas, std_s: np.ndarray) -> np.ndarray:
    """Return the errors of arrivals about their weighted mean: when an emission began is anyone's guess."""
    errors = tdoas.sound.arrival_s - made.arrival_s
    weights = 1 / std_s**2
    return errors - (errors * weights).sum(axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("signal", ["sweep", "mls"])
@pytest.mark.parametrize("mode", ["matched", "gcc-phat"])
def test_half_a_metre_20_db(tmp_path, signal, mode):
    made = make_room_sound(Scenario(signal, distance_m=0.5, snr_db=20.0, rt60_s=0.5, n_poses=5, seed=1))
    tdoas = measured(tmp_path, made, mode)
    errors = errors_s(made, tdoas)
    assert len(errors) == tdoas.tdoa_s.size
    assert np.median(errors) <= 0.4e-6
    assert np.percentile(errors, 95) <= 1.5e-6
    assert errors.max() <= 20e-6
    if mode == "matched":
        chi_square = np.sum((deviations_s(made, tdoas, tdoas.sound.std_s) / tdoas.sound.std_s) ** 2) / (7 * 30)
        assert 0.7 < chi_square < 1.4  # echo is not Gaussian


@pytest.mark.parametrize("signal", ["sweep", "mls"])
def test_two_metres_0_db(tmp_path, signal):
    made = make_room_sound(Scenario(signal, distance_m=2.0, snr_db=0.0, rt60_s=0.5, n_poses=6, seed=2))
    tdoas = measured(tmp_path, made)
    errors = errors_s(made, tdoas)
    assert np.median(errors) <= 1.5e-6
    assert np.mean(errors > 20e-6) < 0.005
    assert 1 - len(errors) / tdoas.tdoa_s.size <= 0.05


@pytest.mark.parametrize("signal", ["sweep", "mls"])
@pytest.mark.parametrize("snr_db", [0.0, 20.0, 40.0])
def test_anechoic_arrivals_reach_the_cramer_rao_bound(tmp_path, signal, snr_db):
    made = make_room_sound(Scenario(signal, rt60_s=0.0, snr_db=snr_db, n_poses=24, seed=3))
    tdoas = measured(tmp_path, made)
    n_free = 7 * len(made.pose)
    against_bound = np.sum((deviations_s(made, tdoas, made.bound_s) / made.bound_s) ** 2) / n_free
    assert np.sqrt(against_bound) < 1.1
    std_s = tdoas.sound.std_s
    assert 0.8 < np.sum((deviations_s(made, tdoas, std_s) / std_s) ** 2) / n_free < 1.25


def test_stated_standard_deviations_follow_the_level(tmp_path):
    """A channel with more noise of its own says so."""
    made = make_room_sound(Scenario(rt60_s=0.0, snr_db=30.0, n_poses=3, seed=4))
    sound = made.sound.copy()
    sound[:, 5] += 10 * sound[:4800, 5].std() * np.random.default_rng(0).standard_normal(len(sound))
    before = measured(tmp_path, made)
    (tmp_path / "s.h5").unlink()
    after = measured(tmp_path, made.with_sound(sound))
    ratio = np.median(after.sound.std_s / before.sound.std_s, axis=0)
    assert ratio[5] == pytest.approx(10, rel=0.25)
    np.testing.assert_allclose(np.delete(ratio, 5), 1, atol=0.05)


def test_a_narrow_buzzer_is_measured_or_ambiguous_but_never_wrong(tmp_path):
    made = make_room_sound(Scenario(rt60_s=0.0, snr_db=0.0, quality=60.0, n_poses=4, seed=5))
    tdoas = measured(tmp_path, made)
    assert tdoas.sound.flaws.table[Flaw.AMBIGUOUS].any()
    assert not (errors_s(made, tdoas) > 20e-6).any()
