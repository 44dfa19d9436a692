"""Arrivals from the TDOAs of all pairs: triples must close, and that tells which of several peaks is the right one.

If every pair measured arrival_j - arrival_i, the TDOAs of n microphones hold n - 1 numbers only: their matrix has
rank two, and T_ij + T_jk = T_ik. Each microphone in turn proposes arrivals from its own pairs; the proposal that most
peaks of the other pairs agree with wins. Peaks that agree with it are fitted by least squares, the rest is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from calib.gcc import Candidates

FloatArray = NDArray[np.float64]

TOLERANCE_SAMPLES = 1.5  # within which peaks agree: under half a period
MIN_AGREEING_SHARE = 0.5  # of a channel's pairs
N_ROUNDS = 3
N_VOTES = 2
EMISSIONS_AT_ONCE = 256


@dataclass(frozen=True)
class Agreement:
    """What the pairs of some emissions agree on.

    Parameters
    ----------
    arrivals : (n, n_channels) array
        In samples, their mean zero; NaN where too few pairs agree.
    std : (n, n_channels) array
        Standard deviation of an arrival in samples, from coherence and from closure, whichever is larger.
    chosen : (n, n_pairs) integer array
        Which candidate of each pair agrees, -1 where none does.
    quality : (n,) array
        Share of the pairs that agree.
    """

    arrivals: FloatArray
    std: FloatArray
    chosen: NDArray[np.intp]
    quality: FloatArray


def agree(candidates: Candidates, pairs: NDArray[np.int32], n_channels: int) -> Agreement:
    """Choose among the candidates of all pairs, some emissions at a time."""
    slabs = [slice(begin, begin + EMISSIONS_AT_ONCE) for begin in range(0, len(candidates.lags), EMISSIONS_AT_ONCE)]
    parts = [_agree(candidates.some(slab), pairs, n_channels) for slab in slabs]
    return Agreement(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Agreement)))


def _agree(candidates: Candidates, pairs: NDArray[np.int32], n_channels: int) -> Agreement:
    arrivals = _best_proposal(candidates, pairs, n_channels)
    open_questions = np.asarray((_nearest(candidates, arrivals, pairs)[0] < 0).any(axis=1))
    if open_questions.any():
        arrivals[open_questions] = _voted(candidates.some(open_questions), arrivals[open_questions], pairs)
    incidence = _incidence(pairs, n_channels)
    heard = np.ones((len(arrivals), n_channels), dtype=bool)
    for _ in range(N_ROUNDS):
        chosen, lags = _nearest(candidates, arrivals, pairs)
        chosen = np.where(heard[:, pairs].all(axis=2), chosen, -1)
        n_agreeing = (chosen >= 0) @ np.abs(incidence)
        heard &= n_agreeing >= MIN_AGREEING_SHARE * (n_channels - 1)
        chosen = np.where(heard[:, pairs].all(axis=2), chosen, -1)
        weights = np.where(chosen >= 0, 1 / np.maximum(candidates.std, 1e-6) ** 2, 0.0)
        arrivals = _least_squares(lags, weights, pairs, n_channels)
    closure = np.where(chosen >= 0, lags - (arrivals[:, pairs[:, 1]] - arrivals[:, pairs[:, 0]]), 0.0)
    variance = np.maximum(_arrival_variance(candidates.std, chosen, incidence), (closure**2) @ np.abs(incidence) / 4)
    std = np.sqrt(variance / np.maximum((chosen >= 0) @ np.abs(incidence), 1))
    quality = (chosen >= 0).mean(axis=1)
    return Agreement(np.where(heard, arrivals, np.nan), np.where(heard, std, np.nan), chosen, quality)


def _voted(candidates: Candidates, arrivals: FloatArray, pairs: NDArray[np.int32]) -> FloatArray:
    """Let every channel's pairs vote in turn, with all their candidates, on when it was, given the other channels."""
    arrivals = arrivals.copy()
    for column in np.tile(np.arange(arrivals.shape[1]), N_VOTES):
        mine = np.flatnonzero((pairs == column).any(axis=1))
        sign = np.where(pairs[mine, 1] == column, 1.0, -1.0)
        others = pairs[mine].sum(axis=1) - column
        votes = (arrivals[:, others, None] + sign[:, None] * candidates.lags[:, mine]).reshape(len(arrivals), -1)
        votes = np.nan_to_num(votes, nan=np.inf)
        scores = candidates.scores[:, mine].reshape(len(arrivals), -1)
        with np.errstate(invalid="ignore"):  # infinity minus infinity: two peaks that are not there
            near = np.abs(votes[:, :, None] - votes[:, None]) < TOLERANCE_SAMPLES
        best = np.argmax(np.where(np.isfinite(votes), np.sum(near * scores[:, None], axis=2), -1.0), axis=1)
        elected = votes[np.arange(len(votes)), best]
        arrivals[:, column] = np.where(np.isfinite(elected), elected, arrivals[:, column])
    return arrivals


def _best_proposal(candidates: Candidates, pairs: NDArray[np.int32], n_channels: int) -> FloatArray:
    best = np.full(len(candidates.lags), -np.inf)
    arrivals = np.zeros((len(best), n_channels))
    table = np.zeros((len(best), n_channels, n_channels))
    table[:, pairs[:, 0], pairs[:, 1]] = np.nan_to_num(candidates.lags[..., 0])
    table -= table.transpose(0, 2, 1)
    for reference in range(n_channels):
        proposed = table[:, reference]
        chosen, _ = _nearest(candidates, proposed, pairs)
        scores = np.take_along_axis(candidates.scores, np.maximum(chosen, 0)[..., None], axis=2)[..., 0]
        support = np.sum(np.where(chosen >= 0, scores, 0.0), axis=1)
        arrivals = np.where((support > best)[:, None], proposed, arrivals)
        best = np.maximum(best, support)
    return arrivals


def _nearest(
    candidates: Candidates, arrivals: FloatArray, pairs: NDArray[np.int32]
) -> tuple[NDArray[np.intp], FloatArray]:
    """Return which candidate (n, n_pairs) is within tolerance of what arrivals say, -1 for none, and its lag."""
    expected = arrivals[:, pairs[:, 1]] - arrivals[:, pairs[:, 0]]
    distance = np.abs(np.nan_to_num(candidates.lags, nan=np.inf) - expected[..., None])
    nearest = np.argmin(distance, axis=2)
    near = np.take_along_axis(distance, nearest[..., None], axis=2)[..., 0] < TOLERANCE_SAMPLES
    lags = np.take_along_axis(candidates.lags, nearest[..., None], axis=2)[..., 0]
    return np.where(near, nearest, -1), np.where(near, lags, 0.0)


def _least_squares(lags: FloatArray, weights: FloatArray, pairs: NDArray[np.int32], n_channels: int) -> FloatArray:
    """Fit arrivals (n, n_channels) of mean zero to lags (n, n_pairs)."""
    incidence = _incidence(pairs, n_channels)
    scaled = weights / np.maximum(weights.max(axis=1, keepdims=True), 1e-300)
    laplacian = np.einsum("np,pi,pj->nij", scaled, incidence, incidence) + 1e-6 * np.eye(n_channels)
    right = (scaled * lags) @ incidence
    arrivals = np.linalg.solve(laplacian + np.ones((n_channels, n_channels)), right[..., None])[..., 0]
    return np.asarray(arrivals - arrivals.mean(axis=1, keepdims=True))


def _arrival_variance(std: FloatArray, chosen: NDArray[np.intp], incidence: FloatArray) -> FloatArray:
    """Return half the sum over its pairs of the variances of their lags (n, n_channels)."""
    return np.asarray(np.where(chosen >= 0, std**2, 0.0) @ np.abs(incidence)) / 2


def _incidence(pairs: NDArray[np.int32], n_channels: int) -> FloatArray:
    rows = np.zeros((len(pairs), n_channels))
    rows[np.arange(len(pairs)), pairs[:, 0]], rows[np.arange(len(pairs)), pairs[:, 1]] = -1.0, 1.0
    return rows
