"""What `rig-calibrate` was asked for on its command line."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import click

from calib.export.formats import chosen_formats
from calib.publication import Publication
from calib.settings import Block, Method, Settings
from calib.sound import TdoaMode

MOST_NAMES = 3  # of sessions, in the name of their result
RESULT_ENDINGS = {".yaml", ".yml"}


@dataclass(frozen=True)
class Request:
    """The values of all options, named as on the command line.

    Parameters
    ----------
    files : tuple of Path
        Sessions, or results in their place.
    output : Path or None
        Of the result, the table or the plot; None: beside the first file.
    export : str or None
        Names of formats, with commas between.

    The others are what `rig-calibrate --help` says of them.

    Raises
    ------
    click.UsageError
        Options that do not go together.
    """

    files: tuple[Path, ...]
    method: Method
    output: Path | None
    overwrite: bool
    seed: int
    tdoa: TdoaMode
    inspect_tdoa: int | None
    reference: int | None
    exclude_channel: tuple[int, ...]
    hold: tuple[Block, ...]
    exact: tuple[Block, ...]
    find_delays: bool
    suggest_poses: int
    ignore_sync: bool
    follow: bool
    each: bool
    cluster: str | None
    compare: bool
    report: bool
    plots: str | None
    export: str | None

    def __post_init__(self) -> None:
        if self.compare and len(self.files) != 2:
            raise click.UsageError(f"--compare takes two results, not {len(self.files)}: name two .calib.yaml files")
        if (self.follow or self.inspect_tdoa is not None) and (self.one_by_one or len(self.files) > 1):
            raise click.UsageError("--follow and --inspect-tdoa take one session")
        if self.one_by_one and (self.plots or self.export):
            raise click.UsageError(
                "--each and --cluster write results and their table: leave --plots to single sessions, and --export "
                "from a result afterwards (rig-calibrate SESSION.calib.yaml --export all)"
            )

    @property
    def file(self) -> Path:
        """The first session, or result."""
        return self.files[0]

    @property
    def one_by_one(self) -> bool:
        """Each session is calibrated by itself."""
        return self.each or self.cluster is not None

    @property
    def names_result(self) -> bool:
        """A result stands in place of a session."""
        return self.file.suffix in RESULT_ENDINGS

    @cached_property
    def settings(self) -> Settings:
        """What the user chose of the calibration."""
        return Settings(
            method=self.method,
            seed=self.seed,
            reference_channel=self.reference,
            excluded_channels=self.exclude_channel,
            tdoa=self.tdoa,
            hold=self.hold,
            find_delays=self.find_delays,
            suggest_poses=self.suggest_poses,
            ignore_sync=self.ignore_sync,
            exact=self.exact,
        )

    @cached_property
    def publication(self) -> Publication:
        """What is to be written beside the result; MethodError where a format is unknown."""
        target = self.output or (self.file if self.names_result else self._beside_sessions())
        return Publication(
            target, self.overwrite, self.report and not self.names_result, self.plots, chosen_formats(self.export)
        )

    def _beside_sessions(self) -> Path:
        if len(self.files) > MOST_NAMES:
            name = f"{self.file.stem}+{len(self.files) - 1}-more"
        else:
            name = "+".join(session.stem for session in self.files)
        return self.file.parent / f"{name}.calib.yaml"  # a name may be empty: "." is refused later
