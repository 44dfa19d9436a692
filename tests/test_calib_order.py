"""Channels in the wrong order, and what may be held."""

import numpy as np
import pytest
import yaml
from conftest import MICROPHONES_M, write_measured_session

from calib.cli import command
from calib.order import order_doubts
from rigs.command import run

CHANNELS = tuple(range(1, 9))


@pytest.mark.parametrize("seed", range(5))
def test_swapped_channels_are_named(seed):
    generator = np.random.default_rng(seed)
    first, second = sorted(generator.choice(8, 2, replace=False))
    order = np.arange(8)
    order[[first, second]] = second, first
    expected_m = MICROPHONES_M + generator.normal(scale=0.03, size=(8, 3))
    doubts = order_doubts(MICROPHONES_M[order], expected_m, CHANNELS)
    assert len(doubts) == 1
    assert doubts[0].startswith(f"channels {first + 1} and {second + 1} look swapped")


def test_the_right_order_is_not_doubted():
    expected_m = MICROPHONES_M + np.random.default_rng(0).normal(scale=0.05, size=(8, 3))
    assert order_doubts(MICROPHONES_M, expected_m, CHANNELS) == []


def test_three_channels_in_a_ring_are_named():
    order = np.array([0, 2, 4, 3, 1, 5, 6, 7])
    assert order_doubts(MICROPHONES_M[order], MICROPHONES_M, CHANNELS) == [
        "channels 2, 3, 5 are mixed up, by audio.expected_positions_m: check their cables"
    ]


def test_swapped_channels_of_a_session_are_named(tmp_path, simulated_description, capsys):
    order = [0, 1, 4, 3, 2, 5, 6, 7]
    expected = tuple(tuple(place.tolist()) for place in MICROPHONES_M[order])
    audio = simulated_description.audio.model_copy(update={"expected_positions_m": expected})
    path = write_measured_session(tmp_path / "s.h5", simulated_description.model_copy(update={"audio": audio}))
    assert run("rig-calibrate", command, [str(path)]) == 0
    warnings = yaml.safe_load(path.with_suffix(".calib.yaml").read_text())["warnings"]
    assert any(warning.startswith("channels 3 and 5 look swapped") for warning in warnings)


def test_what_is_held_stays(tmp_path, simulated_description, capsys):
    path = write_measured_session(tmp_path / "s.h5", simulated_description)
    assert run("rig-calibrate", command, [str(path), "--hold", "speed", "--hold", "intrinsics"]) == 0
    result = yaml.safe_load(path.with_suffix(".calib.yaml").read_text())
    assert result["speed_of_sound_m_s"] == pytest.approx(simulated_description.medium.speed_m_s(), abs=1e-4)
    assert result["speed_of_sound_std_m_s"] == pytest.approx(simulated_description.medium.speed_std_m_s(), abs=1e-3)
    assert result["camera"]["focal_px"] == [940, 940]


def test_the_papers_methods_hold_all_anyway(tmp_path, simulated_description, capsys):
    path = write_measured_session(tmp_path / "s.h5", simulated_description)
    assert run("rig-calibrate", command, [str(path), "--method", "ours-2", "--hold", "speed"]) == 2
    assert "leave --hold" in capsys.readouterr().err
