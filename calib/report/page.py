"""The page: everything put together, by Jinja with every text escaped."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from calib.joint.next_pose import ONE_AFTER_ANOTHER
from calib.joint.observability import board_tilts_deg
from calib.rejections import KINDS, Rejection
from calib.report.geometry import MOST_BOARDS
from calib.report.inline import inlined
from calib.report.names import LABELS
from calib.report.photograph import photograph
from calib.report.plots import MOST_POINTS, as_file, noise_floor_s, plots
from calib.report.scene import scene
from calib.report.verdict import judge
from calib.report.words import (
    MEANINGS,
    command_line,
    settings_table,
    short,
    two_digits,
    versions_table,
    weak_directions,
)
from calib.result import Calibration
from calib.settings import Settings
from rigs import __version__
from rigs.description import RigDescription
from rigs.session.info import summary
from rigs.session.reader import Session

HERE = Path(__file__).parent
MOST_ROWS, MOST_DISTANCES = 60, 12
FINE_M = 0.001
CLASSES = {"good": "good", "usable": "usable", "do not use": "bad"}
MARKS = {"good": "✓", "usable": "!", "do not use": "✕"}
FACTORS = (1, 10, 100, 1000)


def report(sessions: list[Session], result: Calibration, settings: Settings, result_name: str) -> bytes:
    """Return the report as one HTML file that needs no other.

    Parameters
    ----------
    sessions : list of Session
        Those that it rests on, open.
    result : Calibration
    settings : Settings
    result_name : str
        Of the YAML file, for the command that makes it again.
    """
    description = sessions[0].description
    recorded = f"{sessions[0].created_utc[:16].replace('T', ' ')} UTC"
    drawn = {name: as_file(draw, "svg") for name, draw in plots(result, description).items()}
    environment = Environment(loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined)
    environment.policies["json.dumps_kwargs"] = {"sort_keys": False, "separators": (",", ":")}
    text = environment.get_template("page.html.jinja").render(
        result=result,
        description=description,
        is_simulated=_is_simulated(description),
        description_text=sessions[0].description_text,
        verdict=(verdict := judge(result, description)),
        asked=[one for one in verdict.criteria if one.level != "good" and one.name != "Warnings"],
        classes=CLASSES,
        marks=MARKS,
        figures=_figures(result, description),
        microphones=_microphones(result),
        std_format="%.3f" if result.std_m.max() < FINE_M else "%.2f",
        distances=_distances_mm(result),
        weak_directions=weak_directions(result),
        scene=(in_space := scene(result, description)),
        factors=sorted({*FACTORS, in_space["exaggeration"]}),
        plots={name: Markup(inlined(svg, name, LABELS[name])) for name, svg in drawn.items()},  # noqa: S704 - our own
        photo=photograph(sessions[0], result),
        poses_sentence=_poses_sentence(result),
        drawn_sentence=_drawn_sentence(result),
        held_out_sentence=_held_out_sentence(result),
        rejected_sentence=_rejected_sentence(result),
        rejected=_rejected(result),
        sound_flaws=_sound_flaws(result),
        truth=_truth(result),
        meanings=MEANINGS,
        one_after_another=ONE_AFTER_ANOTHER,
        command=command_line([session.path.name for session in sessions], result_name, settings),
        fit=_fit(result),
        settings=settings_table(settings),
        sessions=_sessions(sessions, result),
        versions=versions_table(),
        recorded=recorded,
        made=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        software=f"acoustic-camera-rig {__version__}",
        page_heads=Markup(_page_heads(result, verdict.level, recorded)),  # noqa: S704 - escaped there
        style=Markup((HERE / "page.css").read_text(encoding="utf-8")),  # noqa: S704 - our own
        script=Markup((HERE / "turn.js").read_text(encoding="utf-8")),  # noqa: S704 - our own
    )
    return text.encode()


def _page_heads(result: Calibration, level: str, recorded: str) -> str:
    """Return the style of what stands on every printed page; each sign of a name is written as its number."""
    boxes = {
        "top-left": f"Calibration of {result.session_name}",
        "top-right": f"recorded {recorded}",
        "bottom-left": f"Verdict: {level}",
    }
    contents = {box: "".join(f"\\{ord(sign):06x}" for sign in words) for box, words in boxes.items()}
    return "".join(f'@page {{ @{box} {{ content: "{content}" }} }}\n' for box, content in contents.items())


def _figures(result: Calibration, description: RigDescription) -> list[tuple[str, str, str]]:
    figures = [
        ("Microphones", str(len(result.channels)), f"from {len(result.view.pose)} board positions"),
        ("Least certain microphone", two_digits(1e3 * float(result.worst_std_m.max())), "mm, one standard deviation"),
        ("Scatter of the TDOAs", two_digits(1e6 * result.residual.robust_sigma_s), "µs"),
    ]
    if result.held_out is not None:
        figures.append(("The same, held-out poses", two_digits(1e6 * result.held_out.robust_sigma_s), "µs"))
    figures.append(("Corners of the board", two_digits(result.view.rms_px), "px rms"))
    if result.evaluation is not None:
        figures.append(
            (_error_name(description), two_digits(1e3 * result.evaluation.rmse_m), "mm rms, against the truth")
        )
    return figures


def _is_simulated(description: RigDescription) -> bool:
    return "simulated" in (description.audio.driver, description.camera.driver, description.trigger.driver)


def _error_name(description: RigDescription) -> str:
    return "Error, as this is a simulation" if _is_simulated(description) else "Error"


def _microphones(result: Calibration) -> list[tuple[int, list[tuple[float, float]], float]]:
    std_mm, worst_mm = 1e3 * result.std_m, 1e3 * result.worst_std_m
    return [
        (channel, list(zip(1e3 * place_m, std, strict=True)), float(worst))
        for channel, place_m, std, worst in zip(result.channels, result.positions_m, std_mm, worst_mm, strict=True)
    ]


def _distances_mm(result: Calibration) -> list[list[tuple[float, float]]]:
    """Return each microphone's distances from those before it, with std; nothing where there are too many."""
    n_mics = len(result.channels)
    if n_mics > MOST_DISTANCES:
        return []
    return [[_distance_mm(result, row, other) for other in range(row)] for row in range(1, n_mics)]


def _distance_mm(result: Calibration, first: int, second: int) -> tuple[float, float]:
    """Return the distance of two microphones and its standard deviation: neighbours err alike, so it may be small."""
    between_m = result.positions_m[second] - result.positions_m[first]
    length_m = float(np.linalg.norm(between_m))
    slope = np.zeros((len(result.channels), 3))
    slope[second], slope[first] = between_m / length_m, -between_m / length_m
    return 1e3 * length_m, 1e3 * float(np.sqrt(slope.ravel() @ result.array_covariance_m2 @ slope.ravel()))


def _sessions(sessions: list[Session], result: Calibration) -> list[list[tuple[str, str]]]:
    """Return what is to be said of each session."""
    if not result.sessions:
        return [[*summary(sessions[0]), ("SHA-256", result.session_sha256)]]
    return [
        [
            *summary(session),
            ("SHA-256", share.sha256),
            ("speed of sound", f"{share.speed_of_sound_m_s:.2f} ± {share.speed_of_sound_std_m_s:.2f} m/s"),
        ]
        for session, share in zip(sessions, result.sessions, strict=True)
    ]


def _poses_sentence(result: Calibration) -> str:
    poses = result.view.board_to_camera
    most, least = board_tilts_deg(np.array([pose.rotation for pose in poses]))
    distances_m = [pose.translation_m[2] for pose in poses]
    return (
        f"{len(poses)} board positions, {min(distances_m):.2f} to {max(distances_m):.2f} m away, tilted by {most:.0f} "
        f"degrees (root mean square) about the axis of most tilt and {least:.0f} about that of least."
    )


def _drawn_sentence(result: Calibration) -> str:
    """Say what a long session's drawings leave out; empty where they show everything."""
    parts, evidence = [], result.evidence
    if len(result.view.pose) > MOST_BOARDS:
        parts.append(f"{MOST_BOARDS} of the board positions")
    if evidence is not None and np.isfinite(evidence.corners_px[:, :, 0]).sum() > MOST_POINTS:
        parts.append(f"{MOST_POINTS} of the corners")
    if evidence is not None and evidence.used.sum() > MOST_POINTS:
        parts.append(f"{MOST_POINTS} of the residuals against distance")
    return f"Drawn are {', '.join(parts)}, evenly chosen; figures rest on all." if parts else ""


def _held_out_sentence(result: Calibration) -> str:
    if result.held_out is None:
        return ""
    floor_s = noise_floor_s(result)
    beside = (
        f" The noise in the recording alone gives some {two_digits(1e6 * floor_s)} µs, an estimate good to twenty per "
        "cent: the fitted poses may lie a little below it."
        if floor_s is not None
        else ""
    )
    held_out, fitted = result.held_out, result.residual
    return (
        "Each fifth of the poses was predicted from the others: they scatter by "
        f"{short(1e6 * held_out.robust_sigma_s, 3)} µs, the fitted ones by {short(1e6 * fitted.robust_sigma_s, 3)} "
        f"µs.{beside} The microphones of the five folds spread by {short(1e3 * held_out.spread_m)} mm."
    )


def _rejected_sentence(result: Calibration) -> str:
    residual, evidence = result.residual, result.evidence
    total = residual.n_used + residual.n_rejected
    if evidence is None:
        return f"{residual.n_rejected} of {total} TDOAs were rejected by the fit."
    n_rejected, n_arrivals = int((evidence.present & ~evidence.used).sum()), int(evidence.present.sum())
    listed = (
        f" The worst {MOST_ROWS} are listed, the result's file has all." if len(result.rejections) > MOST_ROWS else ""
    )
    return (
        f"{n_rejected} of {n_arrivals} arrivals, and {residual.n_rejected} of {total} TDOAs, were rejected by the "
        f"fit.{listed}"
    )


def _rejected(result: Calibration) -> list[Rejection]:
    """Return what was left out: poses, channels, emissions, then single arrivals, the worst first."""
    return sorted(result.rejections, key=lambda one: (KINDS.index(one.kind), -one.sigmas))[:MOST_ROWS]


def _sound_flaws(result: Calibration) -> list[tuple[str, str, str]]:
    if result.sound is None:
        return []
    rows = [(f"channel {one['channel']}", ", ".join(one["flaws"]), "all along") for one in result.sound["channels"]]
    for one in result.sound["emissions"]:
        if one["left_out"]:  # stands among the rejected
            continue
        where = f"emission {one['emission']}, pose {one['pose']}, buzzer {one['buzzer']}"
        reasons = [f"{flaw} (channel {', '.join(map(str, channels))})" for flaw, channels in one["flaws"].items()]
        rows.append((where, "; ".join(reasons), "used as far as it was heard"))
    return rows[:MOST_ROWS]


def _truth(result: Calibration) -> list[tuple[str, str]]:
    found = result.evaluation
    if found is None:
        return []
    rows = [
        ("error, all microphones", f"{short(1e3 * found.rmse_m, 3)} mm root mean square in the camera frame"),
        ("after rigid alignment", f"{short(1e3 * found.rmse_aligned_m, 3)} mm: the array's shape alone"),
        ("turned by", f"{found.rotation_deg:.2f} degrees"),
        ("distances between microphones", f"{short(1e3 * found.distance_rmse_m, 3)} mm root mean square"),
    ]
    if found.paper_rmse_m is not None:
        rows.append(("paper's figure", f"{short(1e3 * found.paper_rmse_m, 3)} mm (microphones 1 to 7 summed, over 8)"))
    return rows


def _fit(result: Calibration) -> list[tuple[str, str]]:
    intrinsics, residual = result.view.intrinsics, result.residual
    held = "held, known to" if result.method != "joint" or "speed" in result.held else "found,"
    return [
        ("TDOAs", f"{residual.n_used} used, {residual.n_rejected} rejected; {short(1e6 * residual.rms_s, 3)} µs rms"),
        ("speed of sound", f"{result.speed_of_sound_m_s:.2f} m/s, {held} ± {result.speed_of_sound_std_m_s:.2f} m/s"),
        ("camera", f"from the {result.view.source}; corners fit to {result.view.rms_px:.3f} px rms"),
        ("focal length", _listed(intrinsics.focal_px, ".2f") + " px"),
        ("principal point", _listed(intrinsics.principal_px, ".2f") + " px"),
        ("distortion k1, k2, p1, p2, k3", _listed(intrinsics.distortion, ".5f")),
    ]


def _listed(values: tuple[float, ...], form: str) -> str:
    return ", ".join(format(value, form) for value in values)
