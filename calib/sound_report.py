"""What was heard in a session and what was wrong with it, as plain values for the result file."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.flaws import OF_CHANNELS
from calib.sound import SoundArrivals
from rigs.session.reader import Session


def sound_report(session: Session, sound: SoundArrivals) -> dict[str, Any]:
    """Return how arrivals were measured, how well, and every flaw by name."""
    heard = np.isfinite(sound.arrival_s)
    channels = [
        {"channel": int(channel), "flaws": [str(flaw) for flaw in sound.flaws.of_channel(column)]}
        for column, channel in enumerate(sound.channels)
    ]
    emissions = [_emission(session, sound, row) for row in range(len(sound.rows))]
    return {
        "tdoa": sound.mode,
        "n_emissions": len(sound.rows),
        "n_left_out": int((heard.sum(axis=1) < 2).sum()),
        "quality": round(float(np.median(sound.quality)), 3),
        "arrival_std_s": float(f"{np.median(sound.std_s[heard]):.3g}"),
        "channels": [one for one in channels if one["flaws"]],
        "emissions": [one for one in emissions if one["flaws"]],
    }


def _emission(session: Session, sound: SoundArrivals, row: int) -> dict[str, Any]:
    emission = session.emissions[sound.rows[row]]
    flaws = {
        str(flaw): [int(channel) for channel, hit in zip(sound.channels, mask[row], strict=True) if hit]
        for flaw, mask in sound.flaws.table.items()
        if flaw not in OF_CHANNELS and mask[row].any()
    }
    return {
        "emission": int(sound.rows[row]),
        "pose": int(emission["pose"]),
        "buzzer": int(emission["buzzer"]),
        "quality": round(float(sound.quality[row]), 3),
        "left_out": bool(np.isfinite(sound.arrival_s[row]).sum() < 2),
        "flaws": flaws,
    }
