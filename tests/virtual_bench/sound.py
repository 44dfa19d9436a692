"""The sound of the buzzers: edges of a driven pin and the board's place in, pressure at the microphones out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.edges import pin_edges
from acquire.devices.simulated.impulses import HALF_WIDTH_SAMPLES, band_limited_impulses
from acquire.devices.simulated.piezo import RING_S, Piezo, draw_piezo, nominal_piezo
from acquire.devices.simulated.room import Room
from acquire.devices.simulated.scene import Scene
from rigs.geometry import Pose

FloatArray = NDArray[np.float64]
_PEAK_AT_1M = 0.08  # of full scale
_GAIN_SPREAD_DB = 2.0
_STRETCH_S = 0.05  # so much of an emission is transformed at once


@dataclass(frozen=True)
class Response:
    """What each microphone hears of one edge of one buzzer, the board being where it is.

    Parameters
    ----------
    spectrum : (n_microphones, n_bins) complex array
    n_samples : int
        How long it lasts.
    stretch_samples : int
        How far apart edges may be that are transformed together.
    """

    spectrum: NDArray[np.complex128]
    n_samples: int
    stretch_samples: int

    def heard(self, position_samples: FloatArray, step: FloatArray) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Render edges; what comes of any two sets of them only has to be added.

        Parameters
        ----------
        position_samples : (n_edges,) array
            When the edges leave the buzzer, in order, in samples of the played stream with their fractions.
        step : (n_edges,) array
            +1 where the pin rises, -1 where it falls.

        Yields
        ------
        first_sample : int
        pressure : (n_samples, n_microphones) array
            Full scale = 1; adjacent ones overlap.
        """
        stretch = ((position_samples - position_samples[0]) // self.stretch_samples).astype(int)
        for number in np.unique(stretch):
            yield self._stretch_heard(position_samples[stretch == number], step[stretch == number])

    def _stretch_heard(self, position_samples: FloatArray, step: FloatArray) -> tuple[int, NDArray[np.float32]]:
        first = int(np.floor(position_samples[0])) - HALF_WIDTH_SAMPLES
        n_edges = int(position_samples[-1] - first) + HALF_WIDTH_SAMPLES + 2
        edges = band_limited_impulses(position_samples[None] - first, step[None], n_edges)[0]
        n_fft = _n_fft(self.stretch_samples, self.n_samples)
        pressure = irfft(rfft(edges, n_fft) * self.spectrum, n_fft, axis=1)[:, : n_edges + self.n_samples - 1]
        return first - 2 * HALF_WIDTH_SAMPLES, pressure.T.astype(np.float32)


class Air:
    """What lies between an edge and a sample: the buzzer's piezo, distance and walls, the microphone's gain.

    Parameters
    ----------
    scene : Scene
    sample_rate_hz : float
    """

    def __init__(self, scene: Scene, sample_rate_hz: float) -> None:
        simulation = scene.description.simulation
        self._scene, self._sample_rate_hz = scene, sample_rate_hz
        self._room = Room(np.array(simulation.room_size_m), simulation.rt60_s, scene.speed_of_sound_m_s)
        self._microphones_m = scene.camera_to_room.apply(scene.microphones_m)
        n_mics = len(self._microphones_m)
        gain_db = draws(scene.seed, "sound device").uniform(-_GAIN_SPREAD_DB, _GAIN_SPREAD_DB, n_mics)
        self._gain = 10 ** (gain_db / 20)
        waveform = scene.description.signal.waveform()
        time_s, step = pin_edges(waveform)
        dry = self._response(np.ones((1, 1)), nominal_piezo())
        pulse = np.zeros(round((waveform.duration_s + 2 * RING_S + 0.1) * sample_rate_hz))
        for first, pressure in dry.heard(time_s * sample_rate_hz + 3 * HALF_WIDTH_SAMPLES, step):
            pulse[first : first + len(pressure)] += pressure[:, 0]
        self._level = _PEAK_AT_1M / np.abs(pulse).max()
        rms = float(np.sqrt(np.sum(pulse**2) / (waveform.duration_s * sample_rate_hz)))
        self.noise_rms = self._level * rms * 10 ** (-simulation.snr_db / 20) * self._gain

    def response(self, buzzer: int, board_to_camera: Pose, place: int) -> Response:
        """Return what the microphones hear of a buzzer (from 0, in the description's order).

        Parameters
        ----------
        buzzer : int
        board_to_camera : Pose
        place : int
            Number of the board's place; the late echo is drawn by it.
        """
        scene = self._scene
        source_m = scene.camera_to_room.apply(board_to_camera.apply(scene.buzzers_m[buzzer]))
        rng = draws(scene.seed, "echo", place + 1, buzzer)
        impulses = self._room.impulse_responses(source_m, self._microphones_m, self._sample_rate_hz, rng)
        return self._response(self._level * self._gain[:, None] * impulses, draw_piezo(scene.seed, buzzer))

    def _response(self, impulses: FloatArray, piezo: Piezo) -> Response:
        """Join a piezo with impulse responses (n_microphones, n) whose time zero is sample HALF_WIDTH_SAMPLES."""
        ring = _ring(piezo, self._sample_rate_hz)
        n_samples = impulses.shape[1] + len(ring) - 1
        stretch_samples = round(_STRETCH_S * self._sample_rate_hz)
        n_fft = _n_fft(stretch_samples, n_samples)
        return Response(rfft(impulses, n_fft, axis=1) * rfft(ring, n_fft), n_samples, stretch_samples)


def _ring(piezo: Piezo, sample_rate_hz: float) -> FloatArray:
    """Return a piezo's answer to an edge (n_samples,), time zero at HALF_WIDTH_SAMPLES, until it has died away."""
    n_fft = next_fast_len(4 * int(RING_S * sample_rate_hz), real=True)
    answer = irfft(piezo.response(rfftfreq(n_fft, 1 / sample_rate_hz)), n_fft)
    return np.asarray(np.roll(answer, HALF_WIDTH_SAMPLES)[: HALF_WIDTH_SAMPLES + int(RING_S * sample_rate_hz)])


def _n_fft(stretch_samples: int, n_samples: int) -> int:
    return int(next_fast_len(stretch_samples + 2 * HALF_WIDTH_SAMPLES + 2 + n_samples, real=True))
