"""What many repetitions come to: quartiles with runaways among them, standard errors, shares in words."""

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from dataclasses import replace

from calib.study.pages import _cell, share_words
from calib.study.scene import Case
from calib.study.summary import CaseSummary, _quartiles, _standard_error

SUMMARY = CaseSummary(
    case=Case(0, 0, "cube", "A", "usual", None, "quiet", "ours-2", 100, "once"),
    scale_s=1e-6,
    n=100,
    n_settled=100,
    rmse_m=0.01224,
    rmse_std_error_m=0.00041,
    paper_rmse_m=0.011,
    median_m=0.012,
    lower_m=0.01,
    upper_m=0.014,
    aligned_median_m=0.008,
    bound_m=0.0131,
    convergence_rate=1.0,
    optimum_rate=0.5,
)


def test_quartiles_are_the_usual_ones_and_runaways_are_infinite():
    values = np.random.default_rng(0).uniform(1, 2, 41)
    for n in (1, 2, 4, 7, 40, 41):
        some = values[:n]
        np.testing.assert_allclose(_quartiles(some, np.full(n, True)), np.percentile(some, [25, 50, 75]))
    near = np.array([True, True, True, False])
    assert _quartiles(np.array([53.7, 88.7, 60.1, 0.1]), near) == (58.5, (60.1 + 88.7) / 2, np.inf)
    assert _quartiles(np.array([92.4, 688e3]), np.array([True, False])) == (np.inf, np.inf, np.inf)


def test_a_standard_error_is_how_much_the_figure_varies():
    draws = np.abs(np.random.default_rng(1).standard_normal((2000, 50)))
    varies = np.std(np.sqrt(np.mean(draws**2, axis=1)))
    assert np.mean([_standard_error(row) for row in draws]) == pytest.approx(varies, rel=0.1)
    assert np.isnan(_standard_error(draws[0, :4]))


def test_only_all_are_100_percent():
    assert [share_words(*each) for each in ((600, 600), (599, 600), (597, 600), (570, 600), (1, 600), (0, 600))] == [
        "100 %", "599 of 600", "597 of 600", "95 %", "1 of 600", "0 %"
    ]  # fmt: skip


def test_a_cell_tells_its_error_and_whom_it_leaves_out():
    assert _cell(SUMMARY, "rmse_m") == "12.24 ± 0.41"
    some = replace(SUMMARY, n_settled=69, convergence_rate=0.69)
    assert (_cell(some, "rmse_m"), _cell(some, "paper_rmse_m")) == ("12.24 ± 0.41 (69/100)", "11 (69/100)")
    assert _cell(replace(SUMMARY, rmse_m=6e-15, rmse_std_error_m=1e-15), "rmse_m") == "0"
    assert _cell(replace(SUMMARY, n_settled=0, rmse_m=np.nan), "rmse_m") == "diverged"
    assert _cell(replace(SUMMARY, median_m=np.inf), "median_m") == "diverged"
