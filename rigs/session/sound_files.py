"""Sound as WAV and FLAC files."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

import numpy as np

from rigs.errors import RigError, TargetError
from rigs.session.excerpts import Excerpt

Format = Literal["wav", "flac"]
FORMATS: tuple[Format, ...] = get_args(Format)
SUBTYPES = {"wav": "FLOAT", "flac": "PCM_24"}  # WAV keeps every sample as it was recorded
MOST_FLAC_CHANNELS = 8


class SoundFormatError(RigError):
    """Sound cannot be written in the form that was asked for."""


def format_of(path: Path, asked: Format | None = None) -> Format:
    """Return the format that a file's ending names, which must be the one that was asked for, if any was.

    Raises
    ------
    SoundFormatError
    """
    for each in FORMATS:
        if path.suffix.lower() == f".{each}":
            if asked not in (None, each):
                raise SoundFormatError(
                    f"{path}: a name for {each.upper()}, but --format {asked} was asked for: leave out --format, or "
                    f"end the name with .{asked}"
                )
            return each
    raise SoundFormatError(f"{path}: sound is written as .wav or .flac: end the name with one of them")


def write_sound(path: Path, excerpt: Excerpt, sample_rate_hz: float, form: Format, named: Path) -> None:
    """Write an excerpt; messages call the file `named`, since it may be written under another name first.

    Raises
    ------
    SoundFormatError
        FLAC cannot hold it.
    TargetError
        It could not be written.
    """
    import soundfile  # noqa: PLC0415 - loads a library that most commands do without

    n_channels = len(excerpt.channels)
    if form == "flac" and n_channels > MOST_FLAC_CHANNELS:
        raise SoundFormatError(
            f"FLAC holds {MOST_FLAC_CHANNELS} channels, the session has {n_channels}: choose some with --channel, or "
            "write WAV"
        )
    samples = excerpt.samples if form == "wav" else np.clip(np.nan_to_num(excerpt.samples), -1.0, 1.0)
    try:
        soundfile.write(path, samples, round(sample_rate_hz), subtype=SUBTYPES[form], format=form.upper())
    except (soundfile.LibsndfileError, RuntimeError) as error:
        raise TargetError(
            f"{named}: could not be written: free some space or choose another disk"  # libsndfile says no more
        ) from error
