"""The commands `rig-session import ...`; hang `import_group` on the group of `rig-session`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click


@click.group("import")
def import_group() -> None:
    """Turn published measurements into session files."""


@import_group.command("aislab")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Session file to write.")
@click.option(
    "--problem",
    type=click.Choice(["28", "7", "8"]),
    default="28",
    show_default=True,
    help="TDOAs: all 28 pairs, 7 against microphone 1, or 8 against the ninth microphone.",
)
@click.option("--layout", type=click.Choice(["A", "B"]), help="Buzzer places [default: A for 28, B for 7 and 8].")
@click.option("--overwrite", is_flag=True, help="Replace the output where it exists.")
def aislab(folder: Path, output: Path, problem: str, layout: Literal["A", "B"] | None, overwrite: bool) -> None:
    """Import the real measurements of arXiv 2502.06196 from FOLDER."""
    from rigs.session.aislab import import_aislab  # noqa: PLC0415 (keeps --help quick)

    n_tdoas: Literal[28, 7, 8] = 28 if problem == "28" else 7 if problem == "7" else 8
    import_aislab(folder, output, problem=n_tdoas, layout=layout, overwrite=overwrite)
    method = {28: "ours-2", 7: "ours-1", 8: "ours-3"}[n_tdoas]
    click.echo(f"{output}: 69 poses, 414 emissions, {n_tdoas} TDOAs each.")
    click.echo(f"next: rig-calibrate {output} --method {method}, as in the paper, or without --method for joint")
