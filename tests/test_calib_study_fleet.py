"""`rig-calibrate --each`: a fleet of sessions, a result each and a table."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import write_measured_session
from dask_cluster import dask_cluster

pytest.importorskip("distributed")

from calib.cli import main
from calib.result_file import read_result
from calib.study import fleet
from calib.study.workers import Workers


@pytest.fixture
def fleet_of_three(tmp_path, simulated_description):
    for seed in range(2):
        write_measured_session(tmp_path / f"s{seed}.h5", simulated_description, seed=seed)
    (tmp_path / "broken.h5").write_bytes(b"not HDF5")
    return [tmp_path / name for name in ("s0.h5", "s1.h5", "broken.h5")]


@pytest.fixture
def rig_calibrate(monkeypatch, capfd):
    monkeypatch.setattr(Workers, "of_machine", classmethod(lambda cls: cls(1)))  # processes are tried by the studies

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rig-calibrate", *map(str, arguments)])
        exit_code = main()
        return exit_code, *capfd.readouterr()

    return run


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_each_session_gets_its_own_result(fleet_of_three, rig_calibrate, tmp_path, monkeypatch):
    exit_code, out, err = rig_calibrate("--each", *fleet_of_three)
    assert exit_code == 5, err  # one of them is broken
    first, second, broken = rows_of(tmp_path / "calibrations.csv")
    assert [first["outcome"], second["outcome"]] == ["good", "good"]
    assert "broken.h5" in broken["outcome"]
    assert "broken.h5" in out
    assert not (tmp_path / "broken.calib.yaml").exists()
    for row, name in ((first, "s0"), (second, "s1")):
        assert len(read_result(tmp_path / f"{name}.calib.yaml").positions_m) == 8
        assert 0 < float(row["rmse_mm"]) < 5
        assert row["n_poses"] == "12"
    solved = []
    calibrate = fleet.calibrate_file
    monkeypatch.setattr(fleet, "calibrate_file", lambda *given: solved.append(given) or calibrate(*given))
    exit_code, out, err = rig_calibrate("--each", *fleet_of_three[:2])
    assert exit_code == 0, err
    assert "2 of 2 sessions have a result, 0 made now" in out
    assert not solved  # what has a result keeps it, and its row
    kept = [row | {"outcome": fleet.KEPT} for row in (first, second)]
    assert rows_of(tmp_path / "calibrations.csv") == kept
    (tmp_path / "s1.calib.yaml").write_text("format: nothing")
    assert rig_calibrate("--each", *fleet_of_three[:2], "-o", tmp_path / "again.csv")[0] == 5
    assert rows_of(tmp_path / "again.csv")[0] == kept[0]
    assert "s1.calib.yaml" in rows_of(tmp_path / "again.csv")[1]["outcome"]


def test_a_cluster_calibrates_a_fleet(fleet_of_three, rig_calibrate, tmp_path):
    alone = tmp_path / "alone"
    alone.mkdir()
    with dask_cluster(tmp_path / "cluster", 2) as cluster:
        exit_code, out, err = rig_calibrate(*fleet_of_three, "--cluster", cluster.address)
    assert exit_code == 5, err
    assert "2 of 3 sessions have a result, 2 made now" in out
    assert [row["outcome"] for row in rows_of(tmp_path / "calibrations.csv")][:2] == ["good", "good"]
    assert "broken.h5" in rows_of(tmp_path / "calibrations.csv")[2]["outcome"]
    assert rig_calibrate(tmp_path / "s1.h5", "--no-report", "-o", alone / "s1.calib.yaml")[0] == 0
    there, here = (read_result(folder / "s1.calib.yaml").positions_m for folder in (tmp_path, alone))
    np.testing.assert_array_equal(there, here)
    assert len(read_result(tmp_path / "s0.calib.yaml").positions_m) == 8


def test_wrong_usage_is_told(fleet_of_three, rig_calibrate, tmp_path):
    for words, arguments in {
        "take one session": ("--each", "--follow"),
        "leave --plots to single sessions": ("--cluster", "tcp://127.0.0.1:1", "--plots", "svg"),
    }.items():
        exit_code, _, err = rig_calibrate(*arguments, *fleet_of_three)
        assert exit_code == 2
        assert words in err
    exit_code, _, err = rig_calibrate("--each", *fleet_of_three, "--cluster", "tcp://127.0.0.1:1")
    assert exit_code == 3
    assert "no scheduler answers" in err
    (tmp_path / "mine.csv").write_text("a,b")
    exit_code, _, err = rig_calibrate("--each", *fleet_of_three, "--overwrite", "-o", tmp_path / "mine.csv")
    assert exit_code == 2
    assert "is no table of --each" in err
    assert not list(tmp_path.glob("*.calib.yaml"))
