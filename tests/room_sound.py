"""Sound of buzzers in a room, by pyroomacoustics: a simulator that shares no code with the project's own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pyroomacoustics
import yaml
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from rigs.description import RigDescription
from rigs.library import find_description
from rigs.session.writer import SessionWriter
from rigs.waveform import Waveform, mls_bits

RATE_HZ = 48000
ROOM_M = (6.1, 5.2, 2.9)
BUZZERS_M = np.array([(x, y, 0.0) for y in (-0.1, 0.1) for x in (-0.15, 0.0, 0.15)])
ARRAY_M = 0.2 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
SPEED_M_S = 343.0
SPACING_S = 0.45
PEAK = 0.2


@dataclass(frozen=True)
class Scenario:
    """What is simulated: how far the board is from the array, how noisy, how reverberant, and what is played."""

    signal: str = "sweep"
    distance_m: float = 0.5
    snr_db: float = 20.0
    rt60_s: float = 0.5
    n_poses: int = 8
    seed: int = 0
    max_order: int = 17
    quality: float | None = None  # of the only resonance; None: three resonances of a usual piezo


@dataclass(frozen=True)
class RoomSound:
    """The sound of a session (n_samples, 8), what is true of it, and what the session says of it.

    `arrival_s` (n_emissions, 8) is true, `bound_s` the Cramer-Rao bound of its standard deviation.
    """

    description: RigDescription
    sound: np.ndarray
    pose: np.ndarray
    buzzer: np.ndarray
    expected_sample: np.ndarray
    arrival_s: np.ndarray
    bound_s: np.ndarray

    def with_sound(self, sound: np.ndarray) -> RoomSound:
        return replace(self, sound=sound.astype(np.float32))


def description_of(scenario: Scenario, **changes: object) -> RigDescription:
    described = find_description("simulated").description.model_dump(mode="json", exclude_none=True)
    described["signal"] = {"kind": scenario.signal, "gap_s": 0.3}
    described["board"]["buzzers"] = [
        {"id": number, "position_m": place.tolist()} for number, place in enumerate(BUZZERS_M, start=1)
    ]
    return RigDescription.model_validate(described | changes)


def make_room_sound(scenario: Scenario) -> RoomSound:
    """Simulate every buzzer once in every pose."""
    rng = np.random.default_rng(scenario.seed)
    description = description_of(scenario)
    waveform = description.signal.waveform()
    n_emissions = scenario.n_poses * len(BUZZERS_M)
    start_s = 0.2 + SPACING_S * np.arange(n_emissions) + rng.uniform(0, 0.01, n_emissions)
    n_samples = round((start_s[-1] + SPACING_S) * RATE_HZ)
    sound = np.zeros((n_samples, 8))
    direct, arrival_s, bound_s = np.zeros((3, n_emissions, 8))
    piezos = [piezo_response(rng, scenario.quality) for _ in BUZZERS_M]
    array_m = np.array(ROOM_M) / 2 + rng.uniform(-0.2, 0.2, 3) + ARRAY_M + rng.normal(0, 0.01, ARRAY_M.shape)
    for pose in range(scenario.n_poses):
        for buzzer, place_m in enumerate(board_in_room(array_m.mean(axis=0), scenario.distance_m, rng)):
            row = pose * len(BUZZERS_M) + buzzer
            flights_s = np.linalg.norm(array_m - place_m, axis=1) / SPEED_M_S
            first = int(start_s[row] * RATE_HZ)
            offset_s = start_s[row] - first / RATE_HZ
            if scenario.rt60_s:
                heard = played(waveform, piezos[buzzer], offset_s, room_responses(place_m, array_m, scenario))
            else:  # delayed exactly: impulse responses would be off by nanoseconds
                late = [
                    played(waveform, piezos[buzzer], offset_s + flight_s, np.ones((1, 1))) for flight_s in flights_s
                ]
                heard = np.concatenate(late) / (SPEED_M_S * flights_s[:, None])
            stop = min(n_samples, first + heard.shape[1])
            sound[first:stop] += heard[:, : stop - first].T
            arrival_s[row] = start_s[row] + flights_s
            dry = played(waveform, piezos[buzzer], 0.0, np.ones((1, 1)))[0]
            slope = irfft(rfft(dry) * 2j * np.pi * rfftfreq(len(dry), 1 / RATE_HZ), len(dry))
            direct[row] = np.sqrt(np.sum(dry**2) / (waveform.duration_s * RATE_HZ)) / (SPEED_M_S * flights_s)
            bound_s[row] = SPEED_M_S * flights_s / np.sqrt(np.sum(slope**2))
    level = PEAK / np.abs(sound).max()
    sound, direct = level * sound, level * direct
    noise_rms = float(np.median(direct) * 10 ** (-scenario.snr_db / 20))
    bound_s *= noise_rms / level
    sound += noise_rms * rng.standard_normal(sound.shape)
    sound *= 10 ** (rng.uniform(-2, 2, 8) / 20)
    expected = np.round(start_s * RATE_HZ + rng.normal(0, 50, n_emissions)).astype(int)
    return RoomSound(
        description,
        sound.astype(np.float32),
        np.repeat(np.arange(scenario.n_poses), len(BUZZERS_M)),
        np.tile(np.arange(1, len(BUZZERS_M) + 1), scenario.n_poses),
        expected,
        arrival_s,
        bound_s,
    )


def piezo_response(rng: np.random.Generator, lone_quality: float | None):
    """Return a function of frequency: three resonances, each a little different in every buzzer."""
    if lone_quality is not None:
        tone_hz = 4000.0 * rng.uniform(0.99, 1.01)
        return lambda frequency_hz: 1 / (1 - (frequency_hz / tone_hz) ** 2 + 1j * frequency_hz / tone_hz / lone_quality)
    centre_hz = np.array([2700.0, 4100.0, 6500.0]) * rng.uniform(0.95, 1.05, 3)
    quality = np.array([8.0, 5.0, 2.0]) * rng.uniform(0.8, 1.2, 3)

    def response(frequency_hz):
        ratio = frequency_hz[:, None] / centre_hz
        resonances = ratio**2 / (1 - ratio**2 + 1j * ratio / quality)
        return (resonances * [1.0, 0.8, 0.9] / quality).sum(axis=1)

    return response


def board_in_room(centre_m: np.ndarray, distance_m: float, rng: np.random.Generator) -> np.ndarray:
    """Place the board at a distance from the array, tilted, everything at least 0.4 m from the walls."""
    while True:
        direction = rng.normal(size=3) * (1, 1, 0.3)
        direction /= np.linalg.norm(direction)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        places_m = centre_m + distance_m * rng.uniform(0.9, 1.2) * direction + BUZZERS_M @ turn.T
        if (places_m > 0.4).all() and (places_m < np.array(ROOM_M) - 0.4).all():
            return places_m


def room_responses(source_m: np.ndarray, receivers_m: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Return impulse responses (8, n) whose time zero is sample 0."""
    absorption, order = pyroomacoustics.inverse_sabine(scenario.rt60_s, ROOM_M)
    pyroomacoustics.constants.set("rir_hpf_enable", False)
    room = pyroomacoustics.ShoeBox(
        ROOM_M, fs=RATE_HZ, materials=pyroomacoustics.Material(absorption), max_order=min(order, scenario.max_order)
    )
    room.set_sound_speed(SPEED_M_S)
    room.add_source(source_m)
    room.add_microphone_array(receivers_m.T)
    room.compute_rir()
    lead = pyroomacoustics.constants.get("frac_delay_length") // 2
    n_samples = min(round(0.4 * RATE_HZ), max(len(response[0]) for response in room.rir))
    out = np.zeros((len(receivers_m), n_samples))
    for row, (response,) in zip(out, room.rir, strict=True):
        row[: len(response) - lead] = response[lead:][:n_samples]
    return out


def played(waveform: Waveform, piezo, delay_s: float, responses: np.ndarray) -> np.ndarray:
    """Return what is heard (n_channels, n): edges of the square wave, late by a delay, through piezo and room."""
    n_fft = next_fast_len(round(waveform.duration_s * RATE_HZ) + responses.shape[1] + 2000, real=True)
    n_fft += n_fft % 2
    frequency_hz = rfftfreq(n_fft, 1 / RATE_HZ)
    spectrum = edges_spectrum(waveform, n_fft) * piezo(frequency_hz)
    spectrum *= np.exp(-2j * np.pi * frequency_hz * delay_s) * (frequency_hz < 0.46 * RATE_HZ)
    return irfft(spectrum * rfft(responses, n_fft, axis=1), n_fft, axis=1)


@cache
def edges_spectrum(waveform: Waveform, n_fft: int) -> np.ndarray:
    """Return the spectrum of the wave between two levels, from the times of its edges."""
    times_s, steps = wave_edges(waveform)
    angular = 2 * np.pi * np.maximum(rfftfreq(n_fft, 1 / RATE_HZ), 1.0)
    total = np.zeros(len(angular), dtype=complex)
    for time_s, step in zip(times_s, steps, strict=True):
        total += step * np.exp(-1j * angular * time_s)
    return total / (1j * angular) * RATE_HZ


def wave_edges(waveform: Waveform) -> tuple[np.ndarray, np.ndarray]:
    if waveform.kind == "mls":
        levels = np.concatenate([[0], mls_bits(waveform.order), [0]])
        times_s = np.flatnonzero(np.diff(levels)) / waveform.chip_rate_hz
    else:
        n_half = int(np.floor((waveform.start_hz + waveform.stop_hz) * waveform.duration_s))
        rate = (waveform.stop_hz - waveform.start_hz) / waveform.duration_s
        half = np.arange(n_half)
        times_s = half / (waveform.start_hz + np.sqrt(waveform.start_hz**2 + rate * half))
    if len(times_s) % 2:
        times_s = np.append(times_s, waveform.duration_s)
    return times_s, np.where(np.arange(len(times_s)) % 2 == 0, 1.0, -1.0)


def write_room_session(path: Path, made: RoomSound, labels: list[str] | None = None) -> Path:
    """Write the sound as a session without pictures."""
    label = made.description.signal.waveform().label()
    with SessionWriter.create(
        path,
        name=path.stem,
        description_text=yaml.safe_dump(made.description.model_dump(mode="json", exclude_none=True)),
        n_channels=8,
        sample_rate_hz=float(RATE_HZ),
        versions={"software": "tests"},
    ) as writer:
        for first in range(0, len(made.sound), 4800):
            writer.append_audio(made.sound[first : first + 4800], host_time_s=first / RATE_HZ, adc_time_s=np.nan)
        for row, pose in enumerate(made.pose):
            writer.append_emission(
                pose=int(pose), buzzer=int(made.buzzer[row]), repeat=0, waveform=labels[row] if labels else label,
                board_time_s=np.nan, host_time_s=np.nan, expected_sample=int(made.expected_sample[row]), accepted=True,
            )  # fmt: skip
        for pose in np.unique(made.pose):
            writer.append_pose(pose=int(pose), start_host_time_s=np.nan, end_host_time_s=np.nan, accepted=True)
    return path
