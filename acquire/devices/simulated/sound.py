"""The sound of an emission, as every microphone of a scene hears it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from acquire.devices.simulated.draws import draws
from acquire.devices.simulated.edges import pin_edges
from acquire.devices.simulated.impulses import HALF_WIDTH_SAMPLES, band_limited_impulses
from acquire.devices.simulated.piezo import RING_S, Piezo, draw_piezo, nominal_piezo
from acquire.devices.simulated.room import Room
from acquire.devices.simulated.scene import Scene
from acquire.devices.simulated.stage import Emission
from rigs.waveform import Waveform

FloatArray = NDArray[np.float64]
_PEAK_AT_1M = 0.08  # of full scale
_SYNC_LEVEL = 0.5


class SoundField:
    """Turns emissions into pressure at the microphones, on the sound device's own sample grid.

    Parameters
    ----------
    scene : Scene
    sample_rate_hz : float
        True samples per second of the host.
    """

    def __init__(self, scene: Scene, sample_rate_hz: float) -> None:
        self._scene = scene
        self._sample_rate_hz = sample_rate_hz
        simulation, speed_m_s = scene.description.simulation, scene.speed_of_sound_m_s
        self._room = Room(np.array(simulation.room_size_m), simulation.rt60_s, speed_m_s)
        self._piezos = [draw_piezo(scene.seed, buzzer) for buzzer in range(len(scene.buzzers_m))]
        self._microphones_m = scene.camera_to_room.apply(scene.microphones_m)
        waveform = scene.description.signal.waveform()
        pulse = _dry(waveform, nominal_piezo(), sample_rate_hz)
        self._level = _PEAK_AT_1M / np.abs(pulse).max()
        self.rms_at_1m = float(self._level * np.sqrt(np.sum(pulse**2) / (waveform.duration_s * sample_rate_hz)))

    def heard(self, emission: Emission, start_sample: float) -> tuple[int, NDArray[np.float32]]:
        """Render one emission.

        Parameters
        ----------
        emission : Emission
        start_sample : float
            Sample number, with its fraction, at which the first edge leaves the buzzer.

        Returns
        -------
        first_sample : int
            Sample number of the first row.
        pressure : (n_samples, n_channels) array
            Full scale = 1; columns as in `Audio.recorded_channels`.
        """
        source_m = emission.board_to_camera.apply(self._scene.buzzers_m[emission.buzzer])
        rng = draws(self._scene.seed, "echo", emission.pose + 1, emission.buzzer)
        source_m = self._scene.camera_to_room.apply(source_m)
        responses = self._room.impulse_responses(source_m, self._microphones_m, self._sample_rate_hz, rng)
        whole = int(np.floor(start_sample))
        rate_hz = self._sample_rate_hz / emission.board_rate
        impulses = _edge_impulses(emission.waveform, rate_hz, start_sample - whole)
        wet = self._level * _filtered(impulses, responses, self._piezos[emission.buzzer], self._sample_rate_hz)
        if self._scene.description.audio.sync_channel is not None:
            wet = np.concatenate([wet, _sync_output(impulses, wet.shape[1])])
        return whole - 2 * HALF_WIDTH_SAMPLES, wet.T.astype(np.float32)


def _edge_impulses(waveform: Waveform, sample_rate_hz: float, offset_samples: float) -> FloatArray:
    """Return the derivative of the pin's voltage (n_samples,); the start is at HALF_WIDTH_SAMPLES + offset."""
    time_s, step = pin_edges(waveform)
    position = time_s * sample_rate_hz + offset_samples + HALF_WIDTH_SAMPLES
    n_samples = int(position[-1]) + HALF_WIDTH_SAMPLES + 2
    return np.asarray(band_limited_impulses(position[None], step[None], n_samples)[0])


def _sync_output(impulses: FloatArray, n_samples: int) -> FloatArray:
    """Return the pin's level (1, n_samples) by wire: without the time and the echoes that the air adds."""
    level = np.zeros((1, n_samples))
    level[0, HALF_WIDTH_SAMPLES : HALF_WIDTH_SAMPLES + len(impulses)] = _SYNC_LEVEL * (
        np.cumsum(impulses) - impulses / 2
    )
    return level


def _filtered(impulses: FloatArray, responses: FloatArray, piezo: Piezo, sample_rate_hz: float) -> FloatArray:
    """Convolve edges (n,) with the piezo and with each response (n_mics, m); the piezo rings a little longer."""
    n_samples = len(impulses) + responses.shape[1] + int(RING_S * sample_rate_hz)
    n_fft = next_fast_len(n_samples, real=True)
    source = rfft(impulses, n_fft) * piezo.response(rfftfreq(n_fft, 1 / sample_rate_hz))
    return np.asarray(irfft(rfft(responses, n_fft, axis=1) * source, n_fft, axis=1)[:, :n_samples])


def _dry(waveform: Waveform, piezo: Piezo, sample_rate_hz: float) -> FloatArray:
    impulses = _edge_impulses(waveform, sample_rate_hz, 0.0)
    return np.asarray(_filtered(impulses, np.ones((1, 1)), piezo, sample_rate_hz)[0])
