"""A look at one emission: what each channel heard, what the filter made of it, and why it was kept or not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.fft import rfft

from calib.emissions import accepted_rows
from calib.errors import MethodError
from calib.flaws import HARMLESS, Flaw
from calib.gcc import MIN_SCORE, N_CANDIDATES, PairCorrelator
from calib.peaks import FIRST_PEAK_SHARE
from calib.sound import SoundArrivals, TdoaMode, find_arrivals, listener_of, windows_of, wrong_labels
from calib.windows import EmissionWindows
from rigs.session.emission_list import whether_it_counts
from rigs.session.reader import Session
from rigs.target import check_target

FloatArray = NDArray[np.float64]

AROUND_S = 0.006
APART_MS = 0.25  # nearer peaks are ripples of one
MIN_SHOWN = 0.1
INCHES_PER_CHANNEL = 1.1
CHOSEN, BAD = "tab:green", "tab:red"


@dataclass(frozen=True)
class View:
    """What is drawn of one emission.

    Parameters
    ----------
    title : str
    mode : {"matched", "gcc-phat"}
    channels : tuple of int
    time_ms, samples : (n,), (n_channels, n) arrays
        The window.
    lag_ms, correlation : (n_lags,), (n_channels, n_lags) arrays
        Filter output around the median arrival, or correlation with the first channel; each scaled to 1.
    chosen_ms : (n_channels,) array
        What was chosen, on the axis of `lag_ms`; NaN where rejected.
    span_ms : (n_channels, 2) array
        Where in the window the sound was taken to be; NaN where it was not found.
    std_us : (n_channels,) array
    verdict : list of str
        For each channel.
    """

    title: str
    mode: str
    channels: tuple[int, ...]
    time_ms: FloatArray
    samples: NDArray[np.float32]
    lag_ms: FloatArray
    correlation: FloatArray
    chosen_ms: FloatArray
    span_ms: FloatArray
    std_us: FloatArray
    verdict: list[str]

    @property
    def threshold(self) -> float:
        """How high a candidate must be, over the highest peak, to be considered."""
        return FIRST_PEAK_SHARE if self.mode == "matched" else MIN_SCORE

    def candidates(self, column: int) -> NDArray[np.intp]:
        """Return the places of the highest peaks of a channel's correlation, at most `N_CANDIDATES`."""
        row = self.correlation[column]
        peaks = np.flatnonzero((row[1:-1] > row[:-2]) & (row[1:-1] >= row[2:]) & (row[1:-1] > MIN_SHOWN)) + 1
        shown: list[int] = []
        for peak in peaks[np.argsort(-row[peaks])]:
            if len(shown) < N_CANDIDATES and (np.abs(self.lag_ms[peak] - self.lag_ms[shown]) > APART_MS).all():
                shown.append(int(peak))
        return np.array(shown, dtype=np.intp)


def inspect(session: Session, number: int, mode: TdoaMode) -> View:
    """Listen to a session and return what there is to see of one emission, numbered as in the session's table from 0.

    Raises
    ------
    MethodError
        There is no such emission, its place in the sound is not known, or the session begins with measured TDOAs.
    """
    rows = _rows_with(session, number)
    row = int(np.flatnonzero(rows == number)[0])
    sound = find_arrivals(session, rows, mode)
    waveform = session.description.signal.waveform()
    if sound.mode == "matched":
        windows, listener = listener_of(session, rows, waveform, wrong_labels(session, rows, waveform))
        matched = listener.filter(int(session.emissions["buzzer"][number]))
        samples = windows.read(np.array([row])).samples
        output = np.abs(matched.filtered(rfft(samples, axis=2))[0]) if matched else np.zeros_like(samples[0])
        centre = _centre(sound, row, windows)
        lag_ms, output = _around(output, centre, windows.sample_rate_hz)
        chosen_ms = 1e3 * (sound.arrival_s[row] - (windows.first_samples[row] + centre) / windows.sample_rate_hz)
    else:
        windows = windows_of(session, rows, waveform)
        samples = windows.read(np.array([row])).samples
        max_lag = session.description.calibration.max_tdoa_s * windows.sample_rate_hz
        lags, output = PairCorrelator(windows.n_samples, None, max_lag).with_first(samples[0])
        lag_ms = 1e3 * lags / windows.sample_rate_hz
        chosen_ms = 1e3 * (sound.arrival_s[row] - sound.arrival_s[row, 0])
    return _view(session, sound, row, windows, samples[0], lag_ms, output, chosen_ms)


def _rows_with(session: Session, number: int) -> NDArray[np.intp]:
    """Return the rows of the emissions that count, and this one."""
    if session.tdoas is not None:
        raise MethodError("this session begins with measured TDOAs: there is no sound to inspect")
    n_emissions = len(session.emissions)
    if number >= n_emissions:
        raise MethodError(
            f"there is no emission {number}, they go from 0 to {n_emissions - 1}: "
            "`rig-session info --emissions` lists them"
        )
    if session.emissions["expected_sample"][number] < 0:
        raise MethodError(f"emission {number} has no known place in the sound: audio was lost while it sounded")
    return np.union1d(accepted_rows(session), [number]).astype(np.intp)


def draw(view: View, path: Path) -> None:
    """Draw a view into a PNG or SVG file."""
    n_channels = len(view.channels)
    figure = Figure(figsize=(13, INCHES_PER_CHANNEL * n_channels + 1), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(view.title)
    axes = figure.subplots(n_channels, 2, sharex="col", squeeze=False)
    for column in range(n_channels):
        _draw_channel(view, column, *axes[column])
    _draw_words(view, axes)
    figure.savefig(path)


def show_view(view: View, path: Path, console: Console) -> None:
    """Print what a view shows, channel by channel."""
    table = Table(title=view.title, title_justify="left")
    for heading in ("channel", "arrival, ms", "std, us"):
        table.add_column(heading, justify="right")
    table.add_column("verdict")
    for channel, chosen, std, verdict in zip(view.channels, view.chosen_ms, view.std_us, view.verdict, strict=True):
        known = np.isfinite(chosen)
        table.add_row(str(channel), f"{chosen:+.4f}" if known else "", f"{std:.3f}" if known else "", verdict)
    console.print(table)
    console.print(f"Written: {path}", soft_wrap=True)


def plot_path(session: Path, number: int, output: Path | None) -> Path:
    """Return where the plot goes: beside the session, if nothing else is asked for.

    Raises
    ------
    TargetError, MethodError
        There is no such folder, or it is neither a PNG nor an SVG file.
    """
    path = output or session.with_suffix(f".emission-{number}.png")
    if path.suffix.lower() not in {".png", ".svg"}:
        raise MethodError(f"{path}: a plot is a .png or an .svg file: name another --output")
    if not path.parent.is_dir():
        check_target(path, replaces=None)
    return path


def _centre(sound: SoundArrivals, row: int, windows: EmissionWindows) -> int:
    arrivals = sound.arrival_s[row][np.isfinite(sound.arrival_s[row])]
    if len(arrivals) == 0:
        return windows.n_samples // 2 - windows.n_played // 2
    return round(float(np.median(arrivals)) * windows.sample_rate_hz - float(windows.first_samples[row]))


def _around(output: NDArray[Any], centre: int, sample_rate_hz: float) -> tuple[FloatArray, FloatArray]:
    reach = round(AROUND_S * sample_rate_hz)
    lags = np.arange(-reach, reach + 1)
    part = output[:, np.clip(centre + lags, 0, output.shape[1] - 1)].astype(float)
    return np.asarray(1e3 * lags / sample_rate_hz, dtype=float), part


def _view(
    session: Session, sound: SoundArrivals, row: int, windows: EmissionWindows, samples: NDArray[np.float32],
    lag_ms: FloatArray, output: FloatArray, chosen_ms: FloatArray,
) -> View:  # fmt: skip
    emission = session.emissions[sound.rows[row]]
    n_kept = int((~sound.flaws.rejected[row]).sum())
    whole = ", ".join(sound.flaws.of_emission(row)) or f"{n_kept} of {len(samples)} channels kept"
    pose_accepted = bool(session.poses["accepted"][session.poses["pose"] == emission["pose"]].any())
    counts = whether_it_counts(bool(emission["accepted"]), pose_accepted, int(emission["expected_sample"]))
    whole += "" if counts == "yes" else f"; does not count{counts.removeprefix('no')}"
    title = f"emission {sound.rows[row]}, pose {emission['pose']}, buzzer {emission['buzzer']}, {sound.mode}: {whole}"
    time_ms = np.asarray(1e3 * np.arange(samples.shape[1]) / windows.sample_rate_hz, dtype=float)
    scaled = output / np.maximum(np.abs(output).max(axis=1, keepdims=True), 1e-30)
    verdict = [_verdict(sound.flaws.of_arrival(row, column)) for column in range(len(samples))]
    std_us = 1e6 * sound.std_s[row]
    begin_s = sound.arrival_s[row] - windows.first_samples[row] / windows.sample_rate_hz
    begin_s = begin_s if sound.mode == "matched" else np.full_like(begin_s, np.nan)
    span_ms = 1e3 * (begin_s[:, None] + np.array([0.0, windows.n_played / windows.sample_rate_hz]))
    return View(
        title, sound.mode, sound.channels, time_ms, samples, lag_ms, scaled, chosen_ms, span_ms, std_us, verdict
    )


def _verdict(flaws: list[Flaw]) -> str:
    rejecting = [flaw for flaw in flaws if flaw not in HARMLESS]
    return f"rejected: {', '.join(rejecting)}" if rejecting else ", ".join(["kept", *flaws])


def _draw_channel(view: View, column: int, left: Any, right: Any) -> None:
    left.plot(view.time_ms, view.samples[column], linewidth=0.4)
    if np.isfinite(view.span_ms[column]).all():
        left.axvspan(*view.span_ms[column], color=CHOSEN, alpha=0.15, label="the emission, as found")
    left.set_ylabel(f"ch {view.channels[column]}")
    right.plot(view.lag_ms, view.correlation[column], linewidth=0.7)
    right.axhline(view.threshold, color="tab:gray", linewidth=0.7, linestyle=":", label="lower ones do not count")
    candidates = view.candidates(column)
    right.plot(
        view.lag_ms[candidates], view.correlation[column, candidates],
        "o", color="tab:orange", markersize=5, fillstyle="none", linestyle="none", label="candidates",
    )  # fmt: skip
    known = np.isfinite(view.chosen_ms[column])
    if known:
        right.axvline(view.chosen_ms[column], color=CHOSEN, linewidth=1, label="chosen")
    found = f"{view.chosen_ms[column]:+.4f} ms +- {view.std_us[column]:.3f} us, " if known else ""
    right.set_title(found + view.verdict[column], fontsize="small", loc="right", pad=2, color=CHOSEN if known else BAD)


def _draw_words(view: View, axes: Any) -> None:
    """Say what the columns and the marks are."""
    matched = view.mode == "matched"
    left, right = axes[0]
    left.set_title("sound, full scale = 1" if matched else "sound, all of it used", fontsize="small", loc="left", pad=2)
    what = "envelope of the filter's output" if matched else f"correlation with channel {view.channels[0]}"
    right.set_title(f"{what}, highest = 1", fontsize="small", loc="left", pad=2)
    for one in (left, right):
        if one.get_legend_handles_labels()[0]:
            one.legend(fontsize="x-small", loc="upper left")
    axes[-1][0].set_xlabel("time in the window, ms")
    axes[-1][1].set_xlabel("after the median arrival, ms" if matched else f"behind channel {view.channels[0]}, ms")
