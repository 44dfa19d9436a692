"""`rig-verify`: a session and a calibration in, a verdict out."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

import click

from rigs.command import run
from rigs.target import session_file

FAILED = 5


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("session", type=click.Path(path_type=Path), callback=session_file)
@click.option(
    "--calibration",
    required=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Result of rig-calibrate (.calib.yaml).",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder to make [default: SESSION.verify].")
@click.option("--overwrite", is_flag=True, help="Replace the folder of an earlier verification.")
@click.option(
    "--limit-deg",
    type=click.FloatRange(min=0, min_open=True),
    default=0.25,
    show_default=True,
    help="Largest median angle between sound and buzzer that passes.",
)
@click.option(
    "--limit-moved-mm",
    type=click.FloatRange(min=0),
    default=1.0,
    show_default=True,
    help="Largest motion of a microphone that is no alarm.",
)
@click.version_option(package_name="acoustic-camera-rig")
def command(
    session: Path, calibration: Path, output: Path | None, overwrite: bool, limit_deg: float, limit_moved_mm: float
) -> int:
    """Locate the sounds of SESSION with a calibrated array, and compare with where the camera saw the buzzers.

    Only poses that the calibration has not used are verified. Writes figures, pictures and a film into SESSION.verify.
    Neither session nor calibration is changed. Exit codes: 0 passed (of motions: unless a line with ? says that it is
    not told), 2 usage, an unfit calibration file or a full disk, 5 failed, or a session missing, damaged or not good
    enough, 130 interrupted.
    """
    from rich.console import Console  # heavy parts are imported only when there is work to do
    from rich.markup import escape

    from calib.result_file import read_result
    from calib.verification.fit import check_fit
    from calib.verification.folder import check_folder, write_folder
    from calib.verification.pipeline import verify
    from calib.verification.screen import show
    from calib.verification.verdict import Limits
    from rigs.session.reader import Session

    console = Console(highlight=False)
    folder = output or session.with_suffix(".verify")
    array = read_result(calibration)
    with Session.open(session) as opened, console.status("opening") as status:
        check_fit(array, opened.description, calibration)
        check_folder(folder, overwrite=overwrite)

        def tell(step: str) -> None:
            status.update(f"{escape(session.name)}: {step} ...")

        verification = verify(opened, array, Limits(limit_deg, limit_moved_mm / 1e3), tell)
        codec = write_folder(verification, opened, folder, overwrite=overwrite, tell=tell)
    with suppress(SystemExit):  # rich ends the program where nobody reads on, as after `| head -1`
        show(verification, folder, codec, console)
    return 0 if verification.verdict.passed else FAILED


def main() -> None:
    """Run the command; errors become one line and an exit code."""
    sys.exit(run("rig-verify", command))
