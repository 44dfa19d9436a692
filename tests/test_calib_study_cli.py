"""`rig-study` from the command line: what it makes, how it goes on, and what it says of bad input."""

import csv
import errno
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import AISLAB

pytest.importorskip("pyarrow")

import pyarrow.parquet as pq

from calib.study import cli, part
from calib.study.cli import main
from calib.study.description import StudyDescription
from calib.study.library import find_study, shipped_studies

SMALL = """
format: acoustic-study
version: 1
name: small
repetitions: 7
arrays: {ring: {kind: ring, n_mics: 5, radius_m: 0.25, rise_m: 0.2}}
boards: {bench: {kind: rig, rig: bench8}}
pose_sets: {few: {kind: drawn, n_poses: 12}}
noises:
  quiet: {law: gaussian, scale_s: 1.0e-6}
  loud: {law: uniform, scale_s: 50.0e-6, grid_s: 41.7e-6, outliers: 0.02}
runs:
  - arrays: [ring]
    boards: [bench]
    pose_sets: [few]
    noises: [quiet, loud]
    methods: [ours-1, ours-2]
    n_poses: [6, 12]
"""


@pytest.fixture
def rig_study(monkeypatch, capfd, tmp_path):
    def run(*arguments: object) -> tuple[int, str, str]:
        words = [str(argument) for argument in arguments]
        if "-o" not in words:
            words += ["-o", str(tmp_path / "out")]
        monkeypatch.setattr(sys, "argv", ["rig-study", *words])
        exit_code = main()
        out, err = capfd.readouterr()
        return exit_code, out, err

    return run


@pytest.fixture
def small(tmp_path):
    def write(text: str = SMALL) -> Path:
        path = tmp_path / "small.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_all_quick(rig_study, tmp_path):
    published = ["--published", AISLAB] if AISLAB.is_dir() else []
    exit_code, out, err = rig_study("all", "--quick", "--workers", "1", *published)
    assert exit_code == 0, err
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "Parameters of the simulations" in report
    assert "uniform from 0 to the scale, on pairs | Gaussian" in report
    made = {path.name for path in (tmp_path / "out").iterdir()}
    simulated = {"table2-as-published", "table2-as-written", "report.md"}
    measured = {f"{name}-{protocol}" for name in ("table3", "fig4") for protocol in ("as-published", "as-written")}
    assert made == (simulated | measured if published else simulated)
    figures = {path.name for path in (tmp_path / "out").glob("*/*.svg")}
    assert figures == ({"noise.svg", "microphones.svg", "space.svg", "poses.svg"} if published else {"noise.svg"})
    assert "made with --quick: one repetition of each combination" in report
    assert "| table2-as-published | Ours-2 (all pairs) | level 1 | 7.936 |" in report
    assert "| buzzers | layout A of the paper's authors, 6 buzzers, for ours-2, joint; layout B" in report
    if published:
        assert "| *the paper prints* | | *24.44* |" in report
        assert "26.06" in report
        assert report.count("those of the authors' ruler") == 4
        assert "Not drawn, since it would hide the others: Legg, authors' search" in report
    else:
        for text in (out, report):
            assert "stand-ins, drawn at random" in text
            assert "table3, fig3 and fig4 are left out" in text


def test_every_cell_of_a_study_is_shown(rig_study, small, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    two = "{ring: {kind: ring, n_mics: 5, radius_m: 0.25, rise_m: 0.2}, cube: {kind: cube}}"
    text = SMALL.replace("{ring: {kind: ring, n_mics: 5, radius_m: 0.25, rise_m: 0.2}}", two).replace(
        "[ring]", "[ring, cube]"
    )
    exit_code, out, err = rig_study(small(text), "--workers", "1")
    assert exit_code == 0, err
    page = (tmp_path / "out" / "small" / "page.md").read_text(encoding="utf-8")
    with (tmp_path / "out" / "small" / "summary.csv").open() as stream:
        summary = list(csv.DictReader(stream))
    assert len({row["rmse_m"] for row in summary}) == len(summary) == 16
    for row in summary:
        shown = f"{1e3 * float(row['rmse_m']):.4g}"
        (line,) = [line for line in page.splitlines() if line.startswith("|") and f" {shown} ± " in line]
        for word in (
            f"array {row['array']}",
            f"noise {row['noise']}",
            "(one reference)" if row["method"] == "ours-1" else "(all pairs)",
        ):
            assert word in line
        assert shown in out
    figure = (tmp_path / "out" / "small" / "poses.svg").read_text(encoding="utf-8")
    for words in ("array cube, noise loud", "array ring, noise quiet", "Cramer-Rao bound", ">small<"):
        assert words in figure


def test_a_study_of_ones_own(rig_study, small, tmp_path):
    exit_code, out, _ = rig_study(small(), "--workers", "1")
    assert exit_code == 0
    folder = tmp_path / "out" / "small"
    table = pq.read_table(folder / "results.parquet")
    assert table.num_rows == 8 * 7
    with (folder / "results.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row["repetition"]) for row in rows] == table.column("repetition").to_pylist()
    np.testing.assert_array_equal([float(row["x_5_m"]) for row in rows], table.column("x_5_m").to_numpy())
    with (folder / "summary.csv").open() as stream:
        summary = {(row["method"], row["noise"], row["n_poses"]): row for row in csv.DictReader(stream)}
    assert len(summary) == 8
    chosen = [row for row in rows if (row["method"], row["noise"], row["n_poses"]) == ("ours-2", "quiet", "12")]
    expected = np.sqrt(np.mean([float(row["rmse_m"]) ** 2 for row in chosen]))
    assert float(summary["ours-2", "quiet", "12"]["rmse_m"]) == pytest.approx(expected)
    assert summary["ours-2", "quiet", "12"]["n"] == "7"
    assert "Ours-2" in out
    page = (folder / "page.md").read_text(encoding="utf-8")
    for line in (
        "| array | ring | 5 on a ring of radius 0.25 m, rising by 0.2 m, centre (0.0, 0.0, 0.0) m |",
        "| board | bench | of rig bench8, 6 buzzers |",
        "| poses taken | 6, 12 | of the pose set, drawn at random for each repetition |",
        "**Note:** bounds are those of the noise without outliers",
    ):
        assert line in page


def test_a_finished_study_is_not_computed_again(rig_study, small, tmp_path, monkeypatch):
    assert rig_study(small(), "--workers", "1")[0] == 0
    lost = tmp_path / "out" / "small" / "parts" / "part-000003.parquet"
    before, content = lost.read_bytes(), (tmp_path / "out" / "small" / "results.parquet").read_bytes()
    computed = []
    solve = part.solve_part
    monkeypatch.setattr("calib.study.run.solve_part", lambda *given: computed.append(given) or solve(*given))
    assert rig_study(small(), "--workers", "1")[0] == 0
    assert not computed
    lost.write_bytes(before[:-10])  # as a crash of the computer may leave it
    assert rig_study(small(), "--workers", "1")[0] == 0
    assert len(computed) == 1
    assert lost.read_bytes() == before
    assert (tmp_path / "out" / "small" / "results.parquet").read_bytes() == content


def test_the_folder_of_another_study_is_refused(rig_study, small, tmp_path):
    assert rig_study(small(), "--workers", "1")[0] == 0
    exit_code, _, err = rig_study(small(SMALL.replace("repetitions: 7", "repetitions: 8")), "--workers", "1")
    assert exit_code == 2
    assert "holds another study (small" in err
    assert pq.read_table(tmp_path / "out" / "small" / "results.parquet").num_rows == 8 * 7
    manifest = tmp_path / "out" / "small" / "manifest.json"
    manifest.write_text(json.dumps([1]))
    assert rig_study(small(), "--workers", "1")[0] == 2


def test_a_folder_that_holds_something_else_is_refused(rig_study, small, tmp_path):
    (tmp_path / "out" / "small").mkdir(parents=True)
    (tmp_path / "out" / "small" / "thesis.tex").write_text("years of work")
    exit_code, _, err = rig_study(small())
    assert exit_code == 2
    assert "holds no study: name another folder" in err


def test_a_full_disk_is_told_and_what_was_finished_stays(rig_study, small, tmp_path, monkeypatch):
    write = Path.write_bytes

    def full(path: Path, content: bytes) -> int:
        if path.name.startswith(".part-000004"):
            write(path, content[:100])
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        exit_code, _, err = rig_study(small(), "--workers", "1")
    assert exit_code == 3
    assert "No space left on device: free some space and run the same command again; finished parts are kept" in err
    parts = sorted(path.name for path in (tmp_path / "out" / "small" / "parts").iterdir())
    assert parts == [f"part-{number:06}.parquet" for number in range(4)]
    assert rig_study(small(), "--workers", "1")[0] == 0


def test_an_interrupt_keeps_what_was_finished(rig_study, small, tmp_path, monkeypatch):
    solve, computed = part.solve_part, []

    def interrupted(*given: object):
        if len(computed) == 2:
            raise KeyboardInterrupt
        computed.append(given)
        return solve(*given)

    monkeypatch.setattr("calib.study.run.solve_part", interrupted)
    exit_code, _, err = rig_study(small(), "--workers", "1")
    told = "rig-study: interrupted: run the same command again to go on; finished parts are kept"
    assert (exit_code, err.strip()) == (130, told)
    assert len(list((tmp_path / "out" / "small" / "parts").iterdir())) == 2
    assert not (tmp_path / "out" / "small" / "results.parquet").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("repetitions: 7", "repetitons: 7", "repetitons: unknown key; did you mean repetitions?"),
        ("repetitions: 7", "repetitions: 0", "repetitions: 0 is less than 1: give at least 1"),
        ("repetitions: 7", "repetitions: many", "repetitions: 'many' is not a whole number"),
        ("n_mics: 5", "n_mics: 1", "small.yaml: arrays.ring.n_mics: 1 is less than 2"),
        ("n_poses: [6, 12]", "n_poses: [6, 6]", "runs[0]: ring, bench, few, quiet, ours-1, 6 comes twice"),
        ("methods: [ours-1, ours-2]", "methods: [ours-1, ours-1]", "comes twice: give it once"),
        ("n_poses: 12", "n_poses: 1", "is more than pose set 'few' has (1): at most 1"),
        ("kind: rig, rig: bench8", "kind: places, buzzers_m: [[0, 0, 0], [0.1, 0, 0]]",
         "board 'bench' is impossible: 8 independent TDOAs for 15 coordinates: give at least 2 poses, or more buzzers"),
        ("kind: ring, n_mics: 5, radius_m: 0.25, rise_m: 0.2", "kind: cubus",
         "arrays.ring.kind: 'cubus' is not known: give one of cube, ring, places, ruler\n"),
        ("law: gaussian, scale_s: 1.0e-6", "law: laplace",
         "noises.quiet.law: 'laplace' is not known: give one of gaussian, uniform, measured\n"),
        ("rig: bench8", "rig: bench8, layout: A", "boards.bench.layout: unknown key; known here: kind, rig\n"),
        ("kind: ring, n_mics: 5, radius_m: 0.25, rise_m: 0.2", "kind: places, microphones_m: [[0, 0, 0], [0, 0, 0]]",
         "array 'ring' is impossible: microphones 1 and 2 are at the same place"),
        ("methods: [ours-1, ours-2]", "methods: [ours-4]", "'ours-4' is not known"),
        ("methods: [ours-1, ours-2]", "methods: [ours-3]", "ours-3 needs a known_microphone"),
        ("noises: [quiet, loud]", "noises: [quite]", "runs[0].noises: there is no 'quite': did you mean 'quiet'?"),
        ("loud: {law: uniform, scale_s: 50.0e-6, grid_s: 41.7e-6, outliers: 0.02}", "loud: {law: measured}",
         "measured TDOAs go with the array kind ruler"),
        ("rig: bench8", "rig: bench9", "boards.bench.rig: bench9: no such rig description (named by this study): "),
        ("n_poses: [6, 12]", "n_poses: [6, 13]", "runs[0].n_poses: 13 is more than pose set 'few' has (12)"),
        ("name: small", "name: ../small", "name: '../small' cannot name a folder everywhere: give up to 80 letters"),
    ],
)  # fmt: skip
def test_a_wrong_study_is_told_in_a_line(rig_study, small, tmp_path, old, new, words):
    text = SMALL.replace("n_poses: [6, 12]", "n_poses: [1]") if "impossible: 8" in words else SMALL
    assert old in text
    exit_code, _, err = rig_study(small(text.replace(old, new)), "--workers", "1")
    assert exit_code == 2
    assert words in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_told(rig_study, small):
    for what in (small(), "table1"):
        exit_code, _, err = rig_study(what, "-o", "/dev/null/results")
        assert exit_code == 3
        assert "/dev/null/results" in err
        assert "no folder can be made there (Not a directory): choose another with -o" in err


def test_workers_do_not_go_with_a_cluster(rig_study, small):
    exit_code, _, err = rig_study(small(), "--workers", "2", "--cluster", "tcp://127.0.0.1:1")
    assert exit_code == 2
    assert "--workers counts processes on this machine: leave it out with --cluster" in err


def test_what_is_not_there_is_told(rig_study, tmp_path):
    exit_code, _, err = rig_study("tabel2")
    assert exit_code == 2
    assert "tabel2: no such study: did you mean table2?" in err
    exit_code, _, err = rig_study("mine")
    assert "mine: no such study: give the path of a YAML file, or one of table1, table2, table3, fig3, fig4, all" in err
    exit_code, _, err = rig_study("fig4-as-written", "--protocol", "as-written")
    assert exit_code == 2
    assert "--protocol goes with table1, table2, table3, fig3, fig4 and all only" in err
    exit_code, _, err = rig_study("fig4")
    assert exit_code == 2
    assert "--published" in err
    exit_code, _, err = rig_study("table2", "--published", tmp_path)
    assert exit_code == 5
    assert "location.mat is missing" in err


def test_without_the_extra_one_line_says_what_to_install(rig_study, small, monkeypatch):
    monkeypatch.setattr(cli, "find_spec", lambda name: None if name == "distributed" else object())
    exit_code, _, err = rig_study(small())
    assert exit_code == 2
    assert err == "rig-study: distributed missing: pip install 'acoustic-camera-rig[study]'\n"


def test_calibration_needs_nothing_of_the_extra():
    program = "import sys, calib.pipeline, calib.cli, calib.study.cli; print(sorted({'pyarrow', 'dask', 'distributed', 'matplotlib'} & set(sys.modules)))"  # noqa: E501
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_every_shipped_study_is_valid():
    assert {find_study(name).name for name in shipped_studies()} == set(shipped_studies())


def test_the_examples_of_the_docs_are_valid():
    text = (Path(__file__).parents[1] / "docs" / "studies.md").read_text(encoding="utf-8")
    whole, *sections = (yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.DOTALL))
    assert StudyDescription.model_validate(whole).repetitions == 200
    assert {key for section in sections for key in section} == set(StudyDescription.model_fields) - {
        "format", "version", "name", "title", "seed", "repetitions", "speed_of_sound_m_s", "search_judged_in", "runs"
    }  # fmt: skip
    for section in sections:
        joined = {key: {**whole.get(key, {}), **value} for key, value in section.items()}
        StudyDescription.model_validate(whole | joined)
