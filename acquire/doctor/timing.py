"""The timing of the sound: lost samples, the sample rate by the host's clock, the latency of the audio path."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from acquire.doctor.hearing import Hearing
from acquire.doctor.listening import AFTER_S, Sounds
from acquire.doctor.row import Part, Row, State

_GROSS_SHARE, _STAMP_S = 0.002, 0.05  # a rate that is another one; how far two stamps may be off
_OFF_PPM = 200.0  # no crystal is further off
_SYNC_SWING = 0.02  # of full scale
_LONG_S, _UNSTEADY_S = 0.3, 0.005


def judge_timing(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Say how well sound and clocks go together."""
    if sounds.n_losses:
        yield _row(
            "samples",
            State.LOOK,
            f"the sound device says that samples were lost, {sounds.n_losses} times",
            "close other programs; a USB port of its own for the sound device",
            losses=sounds.n_losses,
        )
    yield _rate(sounds, hearing.sample_rate_hz)
    if sounds.sync.size and sounds.starts:
        yield _sync(sounds)
    if np.isfinite(hearing.onset_s).any():
        yield _latency(hearing)


def _rate(sounds: Sounds, nominal_hz: float) -> Row:
    coarse_hz = nominal_hz if sounds.n_losses else sounds.span_samples / sounds.span_s  # what is lost is no rate
    if abs(coarse_hz / nominal_hz - 1) > _GROSS_SHARE + _STAMP_S / sounds.span_s:
        finding = f"{coarse_hz:.0f} samples/s arrive, audio.sample_rate_hz says {nominal_hz:.0f}"
        remedy = "set the device to the rate of the description; close other programs; try another USB port"
        return _row("sample rate", State.BAD, finding, remedy, rate_hz=coarse_hz)
    off_ppm, std_ppm = 1e6 * (sounds.fit.rate / nominal_hz - 1), 1e6 * sounds.fit.rate_std
    figures = {"off_ppm": off_ppm, "off_std_ppm": std_ppm, "span_s": sounds.span_s}
    finding = f"{nominal_hz:.0f} Hz {off_ppm:+.0f} ppm by the computer's clock (standard deviation {std_ppm:.0f} ppm)"
    if abs(off_ppm) - 3 * std_ppm > _OFF_PPM:
        return _row("sample rate", State.LOOK, finding, "choose the device's own clock, not a resampled one", **figures)
    return _row("sample rate", State.OK, finding, "", **figures)


def _latency(hearing: Hearing) -> Row:
    of_buzzers_s = np.nanmedian(hearing.onset_s[:, hearing.heard().any(axis=0)], axis=0)
    latency_s, spread_s = float(np.median(of_buzzers_s)), float(np.ptp(of_buzzers_s))
    figures = {"latency_s": latency_s, "spread_s": spread_s}
    finding = f"heard {1e3 * latency_s:.1f} ms after the board's word, the same within {1e3 * spread_s:.1f} ms"
    if latency_s > min(_LONG_S, AFTER_S):
        remedy = "choose the sound device itself, not a sound server, or a smaller buffer"
        return _row("latency", State.LOOK, finding, remedy, **figures)
    if spread_s > _UNSTEADY_S:
        remedy = "close other programs; if it stays, choose the sound device itself, not a sound server"
        return _row("latency", State.LOOK, finding, remedy, **figures)
    return _row("latency", State.OK, finding, "", **figures)


def _sync(sounds: Sounds) -> Row:
    """Tell whether the board's sync output arrives: it moves far when a buzzer sounds, and not at all before."""
    before, after = (float(np.ptp(part)) for part in (sounds.sync[: sounds.quiet_end], sounds.sync[sounds.quiet_end :]))
    figures = {"quiet": before, "swing": after}
    if after > max(_SYNC_SWING, 10 * before):
        return _row("sync output", State.OK, f"arrives, with a swing of {after:.2f} of full scale", "", **figures)
    finding = f"does not arrive: a swing of {after:.3f} of full scale, {before:.3f} in the quiet"
    return _row("sync output", State.LOOK, finding, "check its wire and audio.sync_channel", **figures)


def _row(subject: str, state: State, finding: str, remedy: str = "", **figures: float) -> Row:
    return Row(Part.SOUND, subject, state, finding, remedy, figures)
