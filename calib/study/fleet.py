"""Many sessions, each calibrated by itself, on this machine or a cluster: a result file each, and a table of all."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from calib.errors import CalibrationError
from calib.pipeline import calibrate
from calib.result import Calibration
from calib.result_document import as_document
from calib.result_file import read_result
from calib.result_writer import write_calibration
from calib.settings import Settings
from calib.study.errors import EndedError
from calib.study.workers import Workers, compute, ended_by_sigterm
from rigs.errors import RigError, TargetExistsError
from rigs.library import load_yaml
from rigs.session.reader import Session
from rigs.target import check_target

SUMMARY, HEADING = "calibrations.csv", b"session,outcome,"
CAPTION = (
    "std: root mean square of the microphones' standard deviations; residual: robust sigma of the TDOAs; "
    "rmse: against the session's truth, where it has one"
)
GOOD, KEPT = "good", "good, made before (--overwrite makes it again)"


@dataclass(frozen=True)
class FleetRow:
    """A line of the table: what became of a session.

    Parameters
    ----------
    session : str
    outcome : str
        GOOD, KEPT, or what went wrong.
    n_poses, n_warnings : int or None
    std_mm : float or None
        Root mean square of the microphones' standard deviations.
    robust_sigma_us, speed_of_sound_m_s, rmse_mm : float or None
        Of the TDOA residuals; found; against the session's truth, where it has one.
    """

    session: str
    outcome: str
    n_poses: int | None = None
    std_mm: float | None = None
    robust_sigma_us: float | None = None
    speed_of_sound_m_s: float | None = None
    rmse_mm: float | None = None
    n_warnings: int | None = None

    @property
    def is_good(self) -> bool:
        """There is a result, of now or of before."""
        return self.outcome in (GOOD, KEPT)


def calibrate_each(
    files: tuple[Path, ...], settings: Settings, workers: Workers, table: Path, *, overwrite: bool, console: Console
) -> list[FleetRow]:
    """Calibrate sessions one by one; results are written as they come, the table at the end.

    Parameters
    ----------
    files : tuple of Path
        Sessions; a cluster's workers read them under the same names.
    settings : Settings
    workers : Workers
    table : Path
        CSV file to write.
    overwrite : bool
        Replace results that are there; else they are kept, and their rows are made of them.
    console : Console

    Raises
    ------
    TargetError, ClusterError, EndedError
    """
    files = tuple(dict.fromkeys(file.absolute() for file in files))
    _check_table(table)
    rows: dict[Path, FleetRow] = {}
    missing = [file for file in files if overwrite or not _result_path(file).exists()]
    with console.status(f"0 of {len(missing)} sessions") as status:

        def done(index: int, outcome: Calibration | str) -> None:
            rows[missing[index]] = _row(missing[index], outcome, overwrite=overwrite)
            status.update(f"{len(rows)} of {len(missing)} sessions")

        try:
            with ended_by_sigterm():
                compute(calibrate_file, [(str(file), settings) for file in missing], workers, done)
        except KeyboardInterrupt as error:
            raise EndedError("interrupted: run the same command again to go on; finished results are kept") from error
    listed = [rows.get(file) or _row_of_before(file) for file in files]
    table.write_text(_csv(listed), encoding="utf-8")
    return listed


def calibrate_file(path: str, settings: Settings) -> Calibration | str:
    """Calibrate a session; return what was wrong where there is no answer."""
    try:
        with Session.open(Path(path)) as session:
            return calibrate(session, settings)
    except (CalibrationError, RigError, OSError) as error:
        return str(error)


def show_fleet(rows: list[FleetRow], table: Path, console: Console) -> None:
    """Print the table, and a line for each session without a result."""
    good, new = [row for row in rows if row.is_good], sum(row.outcome == GOOD for row in rows)
    if good:
        console.print(_shown(good))
    for row in rows:
        if not row.is_good:
            console.print(Text(f"! {row.session}: {row.outcome}"), soft_wrap=True)
    console.print(
        Text(f"{len(good)} of {len(rows)} sessions have a result, {new} made now. Written: {table}"), soft_wrap=True
    )


def _shown(rows: list[FleetRow]) -> Table:
    shown = Table(box=box.SIMPLE_HEAD, title="Sessions, each calibrated by itself", caption=CAPTION)
    for name in ("session", "poses", "std, mm", "residual, us", "speed, m/s", "rmse, mm", "warnings"):
        shown.add_column(name, justify="left" if name == "session" else "right")
    for row in rows:
        figures = (row.n_poses, row.std_mm, row.robust_sigma_us, row.speed_of_sound_m_s, row.rmse_mm, row.n_warnings)
        shown.add_row(Text(row.session), *("" if figure is None else f"{figure:.4g}" for figure in figures))
    return shown


def _check_table(table: Path) -> None:
    """Refuse what is no such table; one of before is written anew, with what is there and what is new."""
    if not table.exists():
        check_target(table)
        return
    if not table.is_file() or not table.read_bytes().startswith(HEADING):
        raise TargetExistsError(f"{table}: is no table of --each: name another --output")


def _row(path: Path, outcome: Calibration | str, *, overwrite: bool) -> FleetRow:
    if isinstance(outcome, str):
        return FleetRow(path.name, outcome)
    try:
        write_calibration(outcome, _result_path(path), overwrite=overwrite)
    except (RigError, OSError) as error:
        return FleetRow(path.name, str(error))
    return _row_of_document(path, GOOD, as_document(outcome))


def _row_of_before(path: Path) -> FleetRow:
    """Return the row of a result that an earlier command made."""
    result = _result_path(path)
    try:
        read_result(result)  # refuses what is none
        return _row_of_document(path, KEPT, load_yaml(result.read_text(encoding="utf-8"), str(result)))
    except (CalibrationError, RigError, OSError) as error:
        return FleetRow(path.name, str(error))


def _row_of_document(path: Path, outcome: str, document: dict[str, Any]) -> FleetRow:
    std_m = np.array([each["std_m"] for each in document["microphones"]])
    evaluation, residual = document.get("evaluation") or {}, document.get("residual") or {}
    return FleetRow(
        session=path.name,
        outcome=outcome,
        n_poses=document["camera"].get("n_poses"),
        std_mm=round(1e3 * float((std_m**2).sum(axis=1).mean() ** 0.5), 4),
        robust_sigma_us=_scaled(residual.get("robust_sigma_s"), 1e6, 4),
        speed_of_sound_m_s=_scaled(document.get("speed_of_sound_m_s"), 1.0, 3),
        rmse_mm=_scaled(evaluation.get("rmse_m"), 1e3, 4),
        n_warnings=len(document.get("warnings") or []),
    )


def _scaled(value: float | None, factor: float, digits: int) -> float | None:
    return None if value is None else round(factor * value, digits)


def _result_path(session: Path) -> Path:
    return session.with_suffix(".calib.yaml")


def _csv(rows: list[FleetRow]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [field.name for field in fields(FleetRow)]
    writer.writerow(names)
    writer.writerows([getattr(row, name) for name in names] for row in rows)
    return text.getvalue()
