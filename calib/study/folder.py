"""The folder that holds a study's results: finished parts, and the tables made of them.

Each part is a Parquet file of its own, written under another name first. So what is there is whole, a study goes on
where it was left, and its size on disk, not in memory, is what a long study costs.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

import rigs
from calib.study.description import StudyDescription
from calib.study.errors import DiskError, FolderError
from calib.study.library import study_text
from calib.study.part import Columns, Part
from calib.study.scene import Case, Scene
from rigs.errors import reason

MANIFEST = "manifest.json"
FORMAT = "acoustic-study-results"


@dataclass(frozen=True)
class StudyFolder:
    """Results of one study.

    Parameters
    ----------
    path : Path
    study : StudyDescription
    parts : list of Part
    n_mics : int
        Of the largest array: how many places a row has.
    """

    path: Path
    study: StudyDescription
    parts: list[Part]
    n_mics: int

    @classmethod
    def open(
        cls, path: Path, study: StudyDescription, scenes: list[tuple[Case, Scene]], parts: list[Part]
    ) -> StudyFolder:
        """Make the folder, or go on with it.

        Raises
        ------
        FolderError
            It holds another study, or something else.
        DiskError
        """
        folder = cls(path, study, parts, max(len(scene.microphones_m) for _, scene in scenes))
        manifest = {
            "format": FORMAT,
            "study": study.name,
            "fingerprint": fingerprint(study, scenes),
            "software": f"acoustic-camera-rig {rigs.__version__}",
        }
        folder._claim(manifest)
        return folder

    def finished(self) -> set[int]:
        """Return the numbers of the parts that are there, whole."""
        return {part.number for part in self.parts if self._is_whole(part)}

    def write_part(self, part: Part, columns: Columns) -> None:
        """Keep a part.

        Raises
        ------
        DiskError
        """
        content = io.BytesIO()
        pq.write_table(self._table(part, columns), content, compression="zstd")
        write_whole(self._part_path(part), content.getvalue())

    def tables(self, parts: list[Part] | None = None, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Return some of the parts, or all, one after the other, with some of their columns, or all."""
        for part in self.parts if parts is None else parts:
            yield pq.read_table(self._part_path(part), columns=None if columns is None else list(columns))

    def write_results(self) -> None:
        """Put the parts together into results.parquet and results.csv, a part at a time.

        Raises
        ------
        DiskError
        """
        try:
            with (
                (self.path / "results.parquet.part").open("wb") as binary,
                (self.path / "results.csv.part").open("wb") as text,
                pq.ParquetWriter(binary, self._schema(), compression="zstd") as parquet,
                pa.csv.CSVWriter(text, self._plain_schema()) as rows,
            ):
                for table in self.tables():
                    parquet.write_table(table)
                    rows.write_table(table.cast(self._plain_schema()))
            for name in ("results.parquet", "results.csv"):
                (self.path / f"{name}.part").replace(self.path / name)
        except OSError as error:
            raise _disk_error(self.path, error) from error

    def write_text(self, name: str, text: str) -> None:
        """Write a small file of the results.

        Raises
        ------
        DiskError
        """
        write_whole(self.path / name, text.encode())

    def _claim(self, manifest: dict[str, str]) -> None:
        path = self.path / MANIFEST
        if path.exists():
            _check_same(self.path, path, manifest)
            return
        if self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
            raise FolderError(f"{self.path}: is there already and holds no study: name another folder with -o")
        make_folder(self.path)
        make_folder(self.path / "parts")
        self.write_text("study.yaml", study_text(self.study))
        self.write_text(MANIFEST, json.dumps(manifest, indent=1) + "\n")

    def _part_path(self, part: Part) -> Path:
        return self.path / "parts" / f"part-{part.number:06}.parquet"

    def _is_whole(self, part: Part) -> bool:
        path = self._part_path(part)
        try:
            return path.exists() and pq.read_metadata(path).num_rows == len(part.repetitions)
        except (OSError, pa.ArrowInvalid):
            return False

    def _table(self, part: Part, columns: Columns) -> pa.Table:
        case, n = part.case, len(part.repetitions)
        noise = self.study.noises[case.noise]
        named: dict[str, Any] = {
            "case": np.full(n, case.number, dtype=np.int32),
            **{name: [getattr(case, name)] * n for name in ("array", "board", "pose_set", "noise", "method")},
            "n_poses": [case.n_poses] * n,
            "scale_s": np.full(n, getattr(noise, "scale_s", np.nan)),
            **columns,
        }
        return pa.table(
            [pa.array(_column(named, field.name, n), field.type) for field in self._schema()], self._schema()
        )

    def _schema(self) -> pa.Schema:
        word = pa.dictionary(pa.int32(), pa.string())
        places = [(f"{axis}_{mic + 1}_m", pa.float64()) for mic in range(self.n_mics) for axis in "xyz"]
        return pa.schema(
            [
                ("case", pa.int32()),
                *((name, word) for name in ("array", "board", "pose_set")),
                ("n_poses", pa.int32()),
                ("noise", word),
                ("scale_s", pa.float64()),
                ("method", word),
                ("repetition", pa.int64()),
                ("settled", pa.bool_()),
                ("at_optimum", pa.float64()),
                ("n_iterations", pa.int32()),
                *((name, pa.float64()) for name in ("rmse_m", "paper_rmse_m", "rmse_aligned_m", "bound_m")),
                *places,
            ]
        )

    def _plain_schema(self) -> pa.Schema:
        return pa.schema(
            [(each.name, pa.string() if pa.types.is_dictionary(each.type) else each.type) for each in self._schema()]
        )


def make_folder(path: Path) -> None:
    """Make a folder, and those that it stands in.

    Raises
    ------
    DiskError
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DiskError(f"{path}: no folder can be made there ({reason(error)}): choose another with -o") from error


def write_whole(path: Path, content: bytes) -> None:
    """Write a small file under another name first, so that what has its name is whole.

    Raises
    ------
    DiskError
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise _disk_error(path.parent, error) from error


def fingerprint(study: StudyDescription, scenes: list[tuple[Case, Scene]]) -> str:
    """Return a hash of all that decides a study's results: its description, and the poses and TDOAs it rests on."""
    digest = hashlib.sha256(study.model_dump_json().encode())
    for _, scene in scenes:
        for array in (scene.microphones_m, scene.buzzers_m, scene.rotations, scene.translations_m, scene.measured_s):
            digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _check_same(folder: Path, path: Path, manifest: dict[str, str]) -> None:
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
        name, found = there["study"], there["fingerprint"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FolderError(f"{path}: cannot be read: name another folder with -o") from error
    if found != manifest["fingerprint"]:
        raise FolderError(
            f"{folder}: holds another study ({name}, with other values, seed, --quick or --published): name another "
            "folder with -o, or delete this one"
        )


def _disk_error(folder: Path, error: OSError) -> DiskError:
    remedy = "free some space" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "make it writable"
    again = "and run the same command again; finished parts are kept"
    return DiskError(f"{folder}: {reason(error)}: {remedy} {again}")


def _column(named: dict[str, Any], name: str, n: int) -> Any:
    return named[name] if name in named else [None] * n
