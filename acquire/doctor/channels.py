"""The channels that hear badly, and the silent buzzers, by what was heard."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from acquire.doctor.hearing import Hearing
from acquire.doctor.listening import Sounds
from acquire.doctor.row import Part, Row, State

FloatArray = NDArray[np.float64]
_UNLIKE_DB = 15.0  # so much weaker, louder or noisier than the median channel
_POOR_SNR_DB, _NO_SNR_DB = 15.0, 3.0
_CLIPPED_SHARE = 0.5
_DIRECT_S = (0.0005, 0.003)  # before and after the onset: sound before its echoes
_NEARLY_ALL = 0.6  # of the votes


def judge_channels(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Say what ails single channels and buzzers, or that nothing does."""
    findings = [
        *_unheard(sounds, hearing),
        *_clipped(hearing),
        *_inverted(sounds, hearing),
        *_unlike(hearing),
        *_poor(hearing),
    ]
    rows = list({row.subject: row for row in reversed(findings)}.values())[::-1]  # of each subject the first, the worst
    if not rows:
        median_db = float(np.nanmedian(hearing.snr_db))
        yield _row(
            "microphones",
            State.OK,
            f"all {len(hearing.channels)} hear all {len(hearing.buzzers)} buzzers, {median_db:.0f} dB over the noise "
            "(median)",
            snr_db=median_db,
        )
    yield from rows


def _row(subject: str, state: State, finding: str, remedy: str = "", **figures: float) -> Row:
    return Row(Part.SOUND, subject, state, finding, remedy, figures)


def _unheard(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Name silent buzzers and dead channels, and what is left of pairs that do not hear one another."""
    heard = hearing.heard()
    if not sounds.samples[:, : len(hearing.channels)].any():
        yield _row(
            "microphones",
            State.BAD,
            "all deliver digital silence",
            "unmute the sound device, switch on its phantom power, or correct audio.device and audio.channels",
        )
        return
    if not heard.any():
        yield _row(
            "microphones",
            State.BAD,
            "none hears any buzzer",
            "check the buzzers' power, and that audio.device and audio.channels name the microphones",
        )
        return
    deaf, mute = ~heard.any(axis=1), ~heard.any(axis=0)
    for buzzer in np.flatnonzero(mute):
        yield _row(f"buzzer {hearing.buzzers[buzzer]}", State.BAD, "no microphone hears it", "check its cable and plug")
    for column in np.flatnonzero(deaf):
        yield _dead(sounds, hearing, int(column))
    for column in np.flatnonzero(~deaf):
        missed = np.flatnonzero(~heard[column] & ~mute)
        if len(missed):
            yield _row(
                f"channel {hearing.channels[column]}",
                State.LOOK,
                f"does not hear {_listed('buzzer', [hearing.buzzers[k] for k in missed])}",
                "its gain up, and nothing between it and the board",
            )


def _dead(sounds: Sounds, hearing: Hearing, column: int) -> Row:
    constant = np.ptp(sounds.samples[:, column]) == 0
    finding = "dead: it delivers one constant value" if constant else "dead: it hears no buzzer, only its own noise"
    remedy = "check its cable, power and mute switch" + (
        ", and that audio.channels names an input that is there" if constant else ""
    )
    noise_dbfs = float(hearing.noise_dbfs[column])
    return _row(f"channel {hearing.channels[column]}", State.BAD, finding, remedy, noise_dbfs=noise_dbfs)


def _clipped(hearing: Hearing) -> Iterator[Row]:
    for column in np.flatnonzero(hearing.clipped.any(axis=1)):
        share = float(hearing.clipped[column].mean())
        state = State.BAD if share > _CLIPPED_SHARE else State.LOOK
        finding = f"clipped by {hearing.clipped[column].sum()} of {len(hearing.buzzers)} buzzers"
        yield _row(f"channel {hearing.channels[column]}", state, finding, "turn its gain down", clipped_share=share)


def _inverted(sounds: Sounds, hearing: Hearing) -> Iterator[Row]:
    """Name channels whose direct sound has the sign against most others, for nearly all buzzers."""
    signs = _signs(sounds, hearing)
    with_most = np.nan_to_num(signs * np.sign(np.nansum(signs, axis=0)))
    share = with_most.sum(axis=1) / np.maximum(np.abs(with_most).sum(axis=1), 1)
    for column in np.flatnonzero(share < -_NEARLY_ALL):
        yield _row(
            f"channel {hearing.channels[column]}",
            State.LOOK,
            "inverted against most others",
            "check the polarity of its cable (hot and cold swapped): beamforming minds",
        )


def _signs(sounds: Sounds, hearing: Hearing) -> FloatArray:
    """Return the sign (n_channels, n_buzzers) of each direct sound against that of one channel; NaN where not heard."""
    before, after = (round(each * hearing.sample_rate_hz) for each in _DIRECT_S)
    signs = np.full(hearing.onset_s.shape, np.nan)
    for k, start in enumerate(sounds.starts):
        model = None
        for column in np.flatnonzero(hearing.heard()[:, k]):
            onset = round(start + hearing.onset_s[column, k] * hearing.sample_rate_hz)
            direct = sounds.samples[max(onset - before, 0) : onset + after, column]
            model = direct if model is None else model
            likeness = np.correlate(direct, model, mode="full")
            signs[column, k] = np.sign(likeness[np.argmax(np.abs(likeness))])
    return signs


def _unlike(hearing: Hearing) -> Iterator[Row]:
    """Name channels and buzzers that are much weaker or louder than the others."""
    level_dbfs = np.where(hearing.heard(), hearing.level_dbfs, np.nan)
    for axis, noun, numbers in ((1, "channel", hearing.channels), (0, "buzzer", hearing.buzzers)):
        heard = np.isfinite(level_dbfs).any(axis=axis)
        typical_dbfs = np.full(heard.shape, np.nan)
        typical_dbfs[heard] = np.nanmedian(np.compress(heard, level_dbfs, axis=1 - axis), axis=axis)
        if not heard.any():
            continue
        off_db = typical_dbfs - np.nanmedian(typical_dbfs)
        for k in np.flatnonzero(np.abs(np.nan_to_num(off_db)) > _UNLIKE_DB):
            how = "weaker" if off_db[k] < 0 else "louder"
            remedy = "set its gain as the others'" if noun == "channel" else "check its plug and what covers it"
            finding = f"{abs(off_db[k]):.0f} dB {how} than the others"
            yield _row(f"{noun} {numbers[k]}", State.LOOK, finding, remedy, off_db=float(off_db[k]))


def _poor(hearing: Hearing) -> Iterator[Row]:
    """Name channels that are noisy, or hear too little over their noise."""
    off_db = hearing.noise_dbfs - np.median(hearing.noise_dbfs)
    for column, channel in enumerate(hearing.channels):
        if not hearing.heard()[column].any():
            continue
        snr_db, noise_dbfs = float(np.nanmedian(hearing.snr_db[column])), float(hearing.noise_dbfs[column])
        figures = {"snr_db": snr_db, "noise_dbfs": noise_dbfs}
        if snr_db < _POOR_SNR_DB:
            state = State.BAD if snr_db < _NO_SNR_DB else State.LOOK
            finding = f"hears the buzzers only {snr_db:.0f} dB over its noise of {noise_dbfs:.0f} dBFS"
            yield _row(f"channel {channel}", state, finding, "a quieter room, louder buzzers, or more gain", **figures)
        elif off_db[column] > _UNLIKE_DB:
            finding = f"noise of {noise_dbfs:.0f} dBFS, {off_db[column]:.0f} dB more than the others"
            yield _row(f"channel {channel}", State.LOOK, finding, "check its cable, shield and gain", **figures)


def _listed(noun: str, numbers: list[int]) -> str:
    return f"{noun}{'s' if len(numbers) > 1 else ''} {', '.join(str(number) for number in numbers)}"
