"""Arrivals from TDOAs that were measured pair by pair.

Triples must close, T_ij + T_jk = T_ik, so wrong pairs give themselves away: each microphone in turn proposes arrivals
by its own pairs, the proposal that most of the other pairs agree with wins, and the pairs that agree are fitted by
least squares. Where all pairs share one microphone there is nothing to check.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

AGREE_SIGMAS = 5.0
LEAST_TOLERANCE_S = 1e-9
LEAST_SHARE = 0.3  # of an arrival's pairs must agree
NOMINAL_STD_S = 1e-6  # only ratios count: the scale is found from the residuals
GRID_PERCENTILE = 5
N_ROUNDS = 20


def arrivals_of_pairs(
    tdoa_s: FloatArray, pairs: NDArray[np.int32], n_mics: int
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Fit arrivals to TDOAs.

    Parameters
    ----------
    tdoa_s : (n_emissions, n_pairs) array
        Arrival at j minus arrival at i; NaN where missing.
    pairs : (n_pairs, 2) integer array
        (i, j), numbers from 0.
    n_mics : int

    Returns
    -------
    arrivals (n_emissions, n_mics), NaN where none; their standard deviations up to a common factor; and which TDOAs
    (n_emissions, n_pairs) agree with them.
    """
    incidence, present = _incidence(pairs, n_mics), np.isfinite(tdoa_s)
    proposals, tolerance_s = _proposals(tdoa_s, pairs, n_mics)
    arrivals_s = _most_supported(tdoa_s, proposals, pairs, tolerance_s)
    for _ in range(N_ROUNDS):
        agree = _misfit_s(tdoa_s, arrivals_s, pairs) <= tolerance_s
        arrivals_s = _fitted(np.where(agree, tdoa_s, 0.0), agree, incidence)
        misfit_s = _misfit_s(tdoa_s, arrivals_s, pairs)[present]
        settled_s = AGREE_SIGMAS * 1.4826 * float(np.median(misfit_s))
        tolerance_s = max(settled_s, tolerance_s / 2, LEAST_TOLERANCE_S)  # by halves, so that the worst goes first
    return *arrivals_that_agree(tdoa_s, pairs, n_mics, agree), agree


def arrivals_that_agree(
    tdoa_s: FloatArray, pairs: NDArray[np.int32], n_mics: int, agree: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Fit arrivals to TDOAs already chosen (n_emissions, n_pairs); return them with their standard deviations."""
    incidence = _incidence(pairs, n_mics)
    agree = agree & np.isfinite(tdoa_s)
    arrivals_s = _fitted(np.where(agree, tdoa_s, 0.0), agree, incidence)
    n_agree, n_present = agree @ np.abs(incidence), np.isfinite(tdoa_s) @ np.abs(incidence)
    heard = (n_agree > 0) & (n_agree >= LEAST_SHARE * n_present)
    std_s = NOMINAL_STD_S * np.sqrt(n_present / np.maximum(n_agree, 1))
    return np.where(heard, arrivals_s, np.nan), np.where(heard, std_s, np.nan)


def _incidence(pairs: NDArray[np.int32], n_mics: int) -> FloatArray:
    rows = np.zeros((len(pairs), n_mics))
    rows[np.arange(len(pairs)), pairs[:, 0]] = -1.0
    rows[np.arange(len(pairs)), pairs[:, 1]] = 1.0
    return rows


def _proposals(tdoa_s: FloatArray, pairs: NDArray[np.int32], n_mics: int) -> tuple[FloatArray, float]:
    """Return what each microphone's pairs say (n_mics, n_emissions, n_mics), and how far apart pairs may be."""
    table = np.full((n_mics, len(tdoa_s), n_mics), np.nan)
    table[np.arange(n_mics), :, np.arange(n_mics)] = 0.0
    table[pairs[:, 0], :, pairs[:, 1]] = tdoa_s.T
    table[pairs[:, 1], :, pairs[:, 0]] = -tdoa_s.T
    closures_s = [
        table[i, :, j] + table[j, :, k] + table[k, :, i]
        for i in range(n_mics) for j in range(i + 1, n_mics) for k in range(j + 1, n_mics)
    ]  # fmt: skip
    closure_s = np.abs(np.array(closures_s))
    return table, _first_tolerance_s(closure_s[np.isfinite(closure_s)])


def _first_tolerance_s(closure_s: FloatArray) -> float:
    """Return how far pairs may be apart, from how triples close (n,): on a grid, exactly or by a step of it."""
    apart = closure_s[closure_s > LEAST_TOLERANCE_S]
    if len(apart) == 0:
        return LEAST_TOLERANCE_S
    # the lower quartile of a Gaussian's absolute values is 0.3186 of its standard deviation
    sigma_s = float(np.percentile(closure_s, 25)) / 0.3186 / np.sqrt(3)
    return float(max(AGREE_SIGMAS * sigma_s, 1.1 * float(np.percentile(apart, GRID_PERCENTILE))))


def _misfit_s(tdoa_s: FloatArray, arrivals_s: FloatArray, pairs: NDArray[np.int32]) -> FloatArray:
    """Return how far TDOAs (n_emissions, n_pairs) are from arrivals (..., n_mics); infinite where missing."""
    misfit_s = np.abs(tdoa_s - (arrivals_s[..., pairs[:, 1]] - arrivals_s[..., pairs[:, 0]]))
    return np.asarray(np.where(np.isnan(misfit_s), np.inf, misfit_s))


def _most_supported(
    tdoa_s: FloatArray, proposals: FloatArray, pairs: NDArray[np.int32], tolerance_s: float
) -> FloatArray:
    support = np.sum(_misfit_s(tdoa_s, proposals, pairs) <= tolerance_s, axis=2)
    best = np.argmax(support, axis=0)
    return np.asarray(np.nan_to_num(proposals[best, np.arange(len(best))]))


def _fitted(tdoa_s: FloatArray, agree: BoolArray, incidence: FloatArray) -> FloatArray:
    """Return the arrivals (n_emissions, n_mics) of mean zero that fit the TDOAs that agree; 0 where none does."""
    laplacian = np.einsum("ep,pi,pj->eij", agree.astype(float), incidence, incidence, optimize=True)
    n_mics = incidence.shape[1]
    pinned = laplacian + np.ones((n_mics, n_mics)) + 1e-9 * np.eye(n_mics)  # of mean zero; unheard ones at 0
    return np.asarray(np.linalg.solve(pinned, ((agree * tdoa_s) @ incidence)[..., None])[..., 0])
