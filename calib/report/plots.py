"""The report's plots, by Matplotlib; no text of a user's stands in any."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle
from numpy.typing import NDArray

from calib.evidence import Evidence
from calib.report.coverage import FIELDS
from calib.report.geometry import SIGMAS_95, board_rims_m, exaggeration, frustum_m, spread
from calib.report.residuals import Group, by_buzzer, by_channel, by_pose, corner_rms_by_pose, over_distance
from calib.result import Calibration
from rigs.description import RigDescription
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]

# Each colour is one of the page's own (page.css), so that the page can put its variable there for light and dark.
INK, MUTED, GRID, PAPER = "#1d2733", "#5b6673", "#dfe5eb", "#fefefe"
SOUND, BOARD, REJECTED = "#b83c0b", "#2f6f9f", "#a3163a"
COLOURS = {
    INK: "--ink",
    MUTED: "--muted",
    GRID: "--grid",
    PAPER: "--paper",
    SOUND: "--sound",
    BOARD: "--board",
    REJECTED: "--rejected",
}
STYLE: Any = {
    "font.size": 9,
    "font.family": "sans-serif",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.frameon": False,
    "figure.facecolor": PAPER,
    "svg.fonttype": "none",
    "svg.hashsalt": "report",
}
WIDTH_IN = 7.4
MOST_POINTS = 6000
AXES = ("x, right (m)", "y, down (m)", "z, forward (m)")
VIEWS = {"above": ("From above", 0, 2), "front": ("As the camera looks", 0, 1), "side": ("From the side", 2, 1)}


def plots(result: Calibration, description: RigDescription) -> dict[str, Callable[[], Figure]]:
    """Return what draws each plot, by its name."""
    drawn: dict[str, Callable[[], Figure]] = {"array": lambda: draw_array(result, description)}
    evidence = result.evidence
    if evidence is not None:
        drawn |= {
            "coverage": lambda: draw_coverage(result, evidence),
            "residuals": lambda: draw_groups(evidence, result.channels),
            "residuals-by-pose": lambda: draw_poses(evidence, result.view.pose),
            "residuals-by-distance": lambda: draw_distances(evidence),
        }
    if result.held_out is not None:
        drawn["held-out"] = lambda: draw_held_out(result)
    return drawn


def as_file(draw: Callable[[], Figure], form: str) -> bytes:
    """Return a plot as the content of a PNG or SVG file."""
    stream = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure = draw()
        FigureCanvasAgg(figure)
        software = "acoustic-camera-rig"
        metadata = {"Software": software} if form == "png" else {"Creator": software, "Date": None}
        figure.savefig(stream, format=form, dpi=150, metadata=metadata)
    return stream.getvalue()


def draw_array(result: Calibration, description: RigDescription) -> Figure:
    """Draw the array, the camera and all boards from three sides."""
    rims_m, far_m, factor = board_rims_m(result, description.board), frustum_m(result), exaggeration(result)
    figure = Figure(figsize=(WIDTH_IN, 4.6), layout="constrained")
    panels = figure.subplot_mosaic([["above", "front"], ["above", "side"]], width_ratios=[1.1, 1])
    for name, (title, across, up) in VIEWS.items():
        axes = panels[name]
        axes.set_title(title)
        axes.plot(rims_m[:, :, across].T, rims_m[:, :, up].T, color=BOARD, linewidth=0.6, alpha=0.55)
        for corner_m, next_m in zip(far_m, np.roll(far_m, -1, axis=0), strict=True):
            axes.plot(*_line(np.array([np.zeros(3), corner_m, next_m]), across, up), color=INK, linewidth=0.7)
        _draw_microphones(axes, result, across, up, factor)
        axes.set_aspect("equal")
        axes.set_xlabel(AXES[across])
        axes.set_ylabel(AXES[up])
        if up == 1:
            axes.invert_yaxis()
    larger = f", drawn {factor} times as large as they are" if factor > 1 else ""
    figure.supxlabel(f"Ellipses hold 95 % of the uncertainty{larger}", fontsize=8, color=MUTED)
    return figure


def draw_coverage(result: Calibration, evidence: Evidence) -> Figure:
    """Draw where in the picture the board was, how it was tilted, and how far away it was."""
    width, height = result.recording.picture_size_px
    figure = Figure(figsize=(WIDTH_IN, 2.9), layout="constrained")
    seen, tilted = figure.subplots(1, 2, width_ratios=[1.55, 1])
    seen.add_patch(Rectangle((0, 0), width, height, fill=False, edgecolor=MUTED))
    for line, n in enumerate(FIELDS):
        between = np.linspace(0, (width, height)[line], n + 1)[1:-1]
        draw, across = (seen.vlines, height) if line == 0 else (seen.hlines, width)
        draw(between, 0, across, color=MUTED, linewidth=0.6, linestyle="--", alpha=0.6)
    corners_px = evidence.corners_px.reshape(-1, 2)
    corners_px = corners_px[np.isfinite(corners_px).all(axis=1)]
    seen.plot(*corners_px[spread(len(corners_px), MOST_POINTS)].T, ".", color=BOARD, markersize=1.6, alpha=0.6)
    seen.set(xlim=(-0.02 * width, 1.02 * width), ylim=(1.02 * height, -0.02 * height), aspect="equal")
    seen.set(title="Corners in the picture", xlabel="px", ylabel="px")
    poses = result.view.board_to_camera
    tilts_deg = np.degrees([_tilts(pose) for pose in poses])
    distances_m = np.array([pose.translation_m[2] for pose in poses])
    marks = tilted.scatter(*tilts_deg.T, c=distances_m, cmap="viridis", s=26, edgecolors=INK, linewidths=0.5)
    reach = max(float(np.abs(tilts_deg).max()) * 1.1, 10.0)
    tilted.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", title="Tilt and distance")
    tilted.set(xlabel="about the upright axis (degrees)", ylabel="about the level axis (degrees)")
    bar = figure.colorbar(marks, ax=tilted, label="distance (m)", shrink=0.85)
    bar.outline.set_visible(False)
    return figure


def draw_groups(evidence: Evidence, channels: tuple[int, ...]) -> Figure:
    """Draw residuals by microphone and by buzzer."""
    figure = Figure(figsize=(WIDTH_IN, 2.7), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _draw_quantiles(left, by_channel(evidence, channels), "channel")
    _draw_quantiles(right, by_buzzer(evidence), "buzzer")
    left.set_ylabel("residual of the arrival (µs)")
    return figure


def draw_poses(evidence: Evidence, poses: NDArray[np.int32]) -> Figure:
    """Draw residuals of arrivals, and of corners, by pose."""
    figure = Figure(figsize=(WIDTH_IN, 3.9), layout="constrained")
    heard, seen = figure.subplots(2, 1, height_ratios=[1.6, 1])
    _draw_quantiles(heard, by_pose(evidence), "pose")
    heard.set(ylabel="arrivals (µs)", xlabel="")
    places = np.arange(len(poses))
    seen.bar(places, corner_rms_by_pose(evidence), color=BOARD, width=0.6)
    _mark_groups(seen, poses.tolist(), "pose")
    seen.set_ylabel("corners (px rms)")
    return figure


def draw_distances(evidence: Evidence) -> Figure:
    """Draw residuals against the distance from buzzer to microphone, with their rms."""
    figure = Figure(figsize=(WIDTH_IN, 2.7), layout="constrained")
    axes = figure.subplots()
    used = evidence.used & evidence.present
    out = evidence.present & ~evidence.used
    distances_m, residuals_us = evidence.distances_m[used], 1e6 * evidence.residuals_s[used]
    some = spread(len(distances_m), MOST_POINTS)
    axes.plot(distances_m[some], residuals_us[some], ".", color=BOARD, alpha=0.55, markersize=3, markeredgewidth=0)
    centres_m, rms_us = over_distance(evidence)
    if len(centres_m):
        axes.plot(centres_m, rms_us, color=SOUND, linewidth=1.6, label="rms, and its negative")
        axes.plot(centres_m, -rms_us, color=SOUND, linewidth=1.6)
    reach = _reach_us(evidence)
    clipped = np.clip(1e6 * evidence.residuals_s[out], -reach, reach)
    axes.plot(evidence.distances_m[out], clipped, "x", color=REJECTED, markersize=4, label=f"rejected ({out.sum()})")
    axes.set(ylim=(-1.08 * reach, 1.08 * reach), xlabel="from buzzer to microphone (m)")
    axes.set_ylabel("residual of the arrival (µs)")
    axes.legend(loc="upper right", ncols=2)
    return figure


def draw_held_out(result: Calibration) -> Figure:
    """Draw the scatter of fitted and held-out TDOAs beside the noise floor."""
    assert result.held_out is not None
    rows = [("fitted poses", result.residual.robust_sigma_s, BOARD)]
    rows.append(("held-out poses", result.held_out.robust_sigma_s, SOUND))
    if (floor_s := noise_floor_s(result)) is not None:
        rows.insert(0, ("noise floor, about", floor_s, MUTED))
    figure = Figure(figsize=(WIDTH_IN, 0.5 + 0.36 * len(rows)), layout="constrained")
    axes = figure.subplots()
    names, sigmas_s, colours = zip(*rows, strict=True)
    bars = axes.barh(names, 1e6 * np.array(sigmas_s), color=colours, height=0.6)
    axes.bar_label(bars, fmt="%.3g µs", padding=4, color=INK)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set(xlabel="scatter of the TDOAs (µs, robust standard deviation)", xmargin=0.12)
    return figure


def noise_floor_s(result: Calibration) -> float | None:
    """Return the scatter that the noise of the recording alone gives a TDOA; None where arrivals were not measured."""
    if result.sound is None:
        return None
    return float(np.sqrt(2) * result.sound["arrival_std_s"])


def _line(points_m: FloatArray, across: int, up: int) -> tuple[FloatArray, FloatArray]:
    return points_m[:, across], points_m[:, up]


def _tilts(pose: Pose) -> tuple[float, float]:
    """Return the board's tilt about the picture's upright and level axes, in radians."""
    normal = pose.rotation[:, 2]
    return float(np.arctan2(normal[0], normal[2])), float(np.arctan2(-normal[1], normal[2]))


def _draw_microphones(axes: Any, result: Calibration, across: int, up: int, factor: int) -> None:
    hidden = 3 - across - up  # microphones that hide one another in this view are labelled on different sides
    middle_m = np.median(result.positions_m[:, hidden])
    for channel, place_m, covariance in zip(result.channels, result.positions_m, result.covariance_m2, strict=True):
        values, vectors = np.linalg.eigh(covariance[np.ix_((across, up), (across, up))])
        minor_m, major_m = 2 * factor * SIGMAS_95 * np.sqrt(np.maximum(values, 0))
        angle_deg = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        centre_m = (place_m[across], place_m[up])
        axes.add_patch(Ellipse(centre_m, major_m, minor_m, angle=angle_deg, facecolor=SOUND, alpha=0.35, linewidth=0))
        axes.plot(*centre_m, ".", color=SOUND, markersize=4)
        offset = (5, 3) if place_m[hidden] <= middle_m else (-11, -9)
        axes.annotate(str(channel), centre_m, xytext=offset, textcoords="offset points", fontsize=8)


def _draw_quantiles(axes: Any, groups: list[Group], kind: str) -> None:
    """Draw for each group a thin bar from 5 to 95 %, a thick one from 25 to 75 %, and the median."""
    places = np.arange(len(groups))
    q05, q25, q50, q75, q95 = np.array([group.quantiles_us for group in groups]).T
    axes.axhline(0, color=MUTED, linewidth=0.8)
    axes.vlines(places, q05, q95, color=BOARD, linewidth=1.2)
    axes.vlines(places, q25, q75, color=BOARD, linewidth=max(2.0, min(9.0, 150 / len(groups))), alpha=0.55)
    axes.plot(places, q50, "_", color=INK, markersize=max(4.0, min(10.0, 180 / len(groups))))
    _mark_groups(axes, [group.label for group in groups], kind)


def _mark_groups(axes: Any, labels: list[int], kind: str) -> None:
    step = max(1, int(np.ceil(len(labels) / 25)))
    axes.set_xticks(np.arange(len(labels))[::step], [str(label) for label in labels[::step]])
    axes.grid(axis="x", visible=False)
    axes.set(xlabel=kind, xlim=(-0.7, len(labels) - 0.3))


def _reach_us(evidence: Evidence) -> float:
    used = evidence.used & evidence.present
    return 1.25e6 * float(np.abs(evidence.residuals_s[used]).max()) if used.any() else 1.0
