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

from calib.emissions import accepted_rows
from calib.errors import MethodError
from calib.flaws import HARMLESS, Flaw
from calib.gcc import PairCorrelator
from calib.sound import SoundArrivals, TdoaMode, find_arrivals, listener_of, windows_of, wrong_labels
from calib.windows import EmissionWindows
from rigs.session.reader import Session
from rigs.target import check_target

FloatArray = NDArray[np.float64]

AROUND_S = 0.006
N_CANDIDATES = 4
INCHES_PER_CHANNEL = 1.1


@dataclass(frozen=True)
class View:
    """What is drawn of one emission.

    Parameters
    ----------
    title, lag_label : str
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
    lag_label: str
    channels: tuple[int, ...]
    time_ms: FloatArray
    samples: NDArray[np.float32]
    lag_ms: FloatArray
    correlation: FloatArray
    chosen_ms: FloatArray
    span_ms: FloatArray
    std_us: FloatArray
    verdict: list[str]

    def candidates(self, column: int) -> NDArray[np.intp]:
        """Return the places of the highest peaks of a channel's correlation."""
        row = self.correlation[column]
        peaks = np.flatnonzero((row[1:-1] > row[:-2]) & (row[1:-1] >= row[2:])) + 1
        return peaks[np.argsort(-row[peaks])[:N_CANDIDATES]]


def inspect(session: Session, number: int, mode: TdoaMode) -> View:
    """Listen to a session and return what there is to see of one emission, numbered as in the session's table from 0.

    Raises
    ------
    MethodError
        There is no such emission, or the session begins with measured TDOAs.
    """
    rows = accepted_rows(session)
    if session.tdoas is not None:
        raise MethodError("this session begins with measured TDOAs: there is no sound to inspect")
    if number not in rows:
        raise MethodError(f"emission {number} is none of the accepted ones: they go from {rows[0]} to {rows[-1]}")
    row = int(np.flatnonzero(rows == number)[0])
    sound = find_arrivals(session, rows, mode)
    waveform = session.description.signal.waveform()
    if sound.mode == "matched":
        windows, listener = listener_of(session, rows, waveform, wrong_labels(session, rows, waveform))
        matched = listener.filter(int(session.emissions["buzzer"][number]))
        samples = windows.read(np.array([row])).samples
        output = np.abs(matched.filtered(samples)[0]) if matched else np.zeros_like(samples[0])
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


def draw(view: View, path: Path) -> None:
    """Draw a view into a PNG or SVG file."""
    n_channels = len(view.channels)
    figure = Figure(figsize=(13, INCHES_PER_CHANNEL * n_channels + 1), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(view.title)
    axes = figure.subplots(n_channels, 2, sharex="col", squeeze=False)
    for column in range(n_channels):
        _draw_channel(view, column, *axes[column])
    axes[-1][0].set_xlabel("time in the window, ms")
    axes[-1][1].set_xlabel(view.lag_label)
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
    whole = ", ".join(sound.flaws.of_emission(row)) or "kept"
    title = f"emission {sound.rows[row]}, pose {emission['pose']}, buzzer {emission['buzzer']}, {sound.mode}: {whole}"
    time_ms = np.asarray(1e3 * np.arange(samples.shape[1]) / windows.sample_rate_hz, dtype=float)
    scaled = output / np.maximum(np.abs(output).max(axis=1, keepdims=True), 1e-30)
    verdict = [_verdict(sound.flaws.of_arrival(row, column)) for column in range(len(samples))]
    std_us = 1e6 * sound.std_s[row]
    begin_s = sound.arrival_s[row] - windows.first_samples[row] / windows.sample_rate_hz
    begin_s = begin_s if sound.mode == "matched" else np.full_like(begin_s, np.nan)
    span_ms = 1e3 * (begin_s[:, None] + np.array([0.0, windows.n_played / windows.sample_rate_hz]))
    lag_label = f"{'after the median arrival' if sound.mode == 'matched' else 'behind the first channel'}, ms"
    return View(title, lag_label, sound.channels, time_ms, samples, lag_ms, scaled, chosen_ms, span_ms, std_us, verdict)


def _verdict(flaws: list[Flaw]) -> str:
    rejecting = [flaw for flaw in flaws if flaw not in HARMLESS]
    return f"rejected: {', '.join(rejecting)}" if rejecting else ", ".join(["kept", *flaws])


def _draw_channel(view: View, column: int, left: Any, right: Any) -> None:
    left.plot(view.time_ms, view.samples[column], linewidth=0.4)
    if np.isfinite(view.span_ms[column]).all():
        left.axvspan(*view.span_ms[column], color="tab:green", alpha=0.15)
    left.set_ylabel(f"ch {view.channels[column]}")
    right.plot(view.lag_ms, view.correlation[column], linewidth=0.7)
    candidates = view.candidates(column)
    right.plot(view.lag_ms[candidates], view.correlation[column, candidates], "o", markersize=4, fillstyle="none")
    if np.isfinite(view.chosen_ms[column]):
        right.axvline(view.chosen_ms[column], color="tab:green", linewidth=1)
    right.set_title(view.verdict[column], fontsize="small", loc="right", pad=1)
