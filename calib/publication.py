"""What stands beside a result: the report, plots, and exports for other tools."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calib.export.formats import endings, export
from calib.outputs import beside, check_outputs, write_outputs
from calib.report.names import LABELS, REPORT
from calib.result import Calibration
from calib.result_file import StoredCalibration, as_stored
from calib.result_writer import as_text
from calib.settings import Settings
from rigs.session.reader import Session


@dataclass(frozen=True)
class Publication:
    """What is to be written beside a result.

    Parameters
    ----------
    target : Path
        Of the result's YAML file.
    overwrite : bool
        Earlier ones may be replaced.
    report : bool
    plots : {"png", "svg"} or None
    formats : tuple of str
        Names of exports.
    """

    target: Path
    overwrite: bool = False
    report: bool = True
    plots: str | None = None
    formats: tuple[str, ...] = ()

    def check(self) -> None:
        """Refuse early what cannot be written.

        Raises
        ------
        TargetError
        """
        drawn = [f".{name}.{self.plots}" for name in LABELS] if self.plots else []
        names = [*([REPORT] if self.report else []), *endings(self.formats), *drawn]
        check_outputs([beside(self.target, name) for name in names], overwrite=self.overwrite)

    def publish(
        self, sessions: list[Session], result: Calibration, settings: Settings, *, with_result: bool = False
    ) -> list[str]:
        """Write everything, with the result itself where that is wanted, or nothing; return the lines that say so.

        Raises
        ------
        TargetError, OSError
        """
        from calib.report.page import report  # noqa: PLC0415 - Matplotlib is large, and --follow ends with it
        from calib.report.plots import as_file, plots  # noqa: PLC0415
        from calib.report.verdict import judge  # noqa: PLC0415

        contents = export(as_stored(result), self.formats) if self.formats else {}
        said = [f"Exported: {beside(self.target, ending)}" for ending in contents]
        if self.plots is not None:
            drawn = {
                f".{name}.{self.plots}": as_file(draw, self.plots)
                for name, draw in plots(result, sessions[0].description).items()
            }
            said += [f"Plotted: {beside(self.target, ending)}" for ending in drawn]
            contents |= drawn
        if self.report:
            contents[REPORT] = report(sessions, result, settings, self.target.name)
            said.append(f"Report: {beside(self.target, REPORT)}")
        self._write(contents, {self.target: as_text(result)} if with_result else {})
        verdict = judge(result, sessions[0].description)
        return [f"Verdict: {verdict.level}. {verdict.sentence}", *said]

    def export_only(self, array: StoredCalibration) -> list[str]:
        """Write the exports of a result that is there already, and return the lines that say so.

        Raises
        ------
        TargetError, OSError
        """
        contents = export(array, self.formats)
        self._write(contents)
        return [f"Exported: {beside(self.target, ending)}" for ending in contents]

    def _write(self, contents: dict[str, bytes], named: dict[Path, bytes] | None = None) -> None:
        there = {beside(self.target, ending): content for ending, content in contents.items()}
        write_outputs({**(named or {}), **there}, overwrite=self.overwrite)
