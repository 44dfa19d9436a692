"""The sound device behind PortAudio."""

from __future__ import annotations

import numpy as np

from acquire.devices.audio_stamps import Buffer, arrival_stamps_s, deliveries, driver_stamp_s, driver_times_are_sane
from acquire.devices.base import AudioBlock
from acquire.devices.recorder import Recorder
from acquire.errors import DeviceError
from acquire.sound_devices import choose_sound_device, sound_devices
from rigs.description import Audio


class PortAudioInput:
    """Records the channels of a rig from the sound device that its description names.

    Parameters
    ----------
    audio : Audio
        With a device.
    """

    def __init__(self, audio: Audio) -> None:
        assert audio.device is not None  # the description saw to it
        self._wanted, self._rate_hz = audio.device, audio.sample_rate_hz
        self._columns = np.array(audio.recorded_channels()) - 1
        self._recorder: Recorder | None = None
        self._uses_driver_times = False
        self._stamp_s = float("-inf")  # of the last block

    def open(self) -> str:
        """Start recording, wait until sound comes steadily, and return the driver's name and version.

        Raises
        ------
        DeviceError
            PortAudio is missing; no device fits, or several; it cannot do the rate or the channels; it is silent.
        """
        self.close()
        device = choose_sound_device(self._wanted, sound_devices())
        n_inputs = int(self._columns.max()) + 1
        if n_inputs > device.inputs:
            raise DeviceError(
                f"audio: channel {n_inputs} is asked for, but there is only {device.describe()}: correct "
                "audio.channels, or name another audio.device"
            )
        self._recorder = Recorder(device, n_inputs, self._rate_hz)
        try:
            driver = self._recorder.start()
        except BaseException:
            self.close()
            raise
        settling = deliveries(self._recorder.take())  # not recorded: its times shift
        self._uses_driver_times = driver_times_are_sane(settling, self._rate_hz)
        clock = "driver" if self._uses_driver_times else "callback"
        return f"{driver}; {device.host_api}: {device.name}; times by the {clock}"

    def read(self) -> list[AudioBlock]:
        """Return the blocks that came in since the last call, in order.

        Raises
        ------
        DeviceError
            The device is not open, or lost: its stream ended, or nothing came for a second.
        """
        if self._recorder is None:
            raise DeviceError("audio: the sound device is not open; open it first")
        blocks = deliveries(self._recorder.take())
        stamps_s = arrival_stamps_s(blocks, self._rate_hz)
        self._uses_driver_times &= driver_times_are_sane(blocks, self._rate_hz)
        return [self._block(block, stamp_s) for block, stamp_s in zip(blocks, stamps_s, strict=True)]

    def close(self) -> None:
        """Stop recording; safe to call twice."""
        if self._recorder is not None:
            self._recorder.stop()
        self._recorder = None

    def _block(self, block: Buffer, latest_s: float) -> AudioBlock:
        stamp_s = min(driver_stamp_s(block), latest_s) if self._uses_driver_times else latest_s
        # The last block may have come so late that it seems to begin after this one; time still goes forward.
        self._stamp_s = stamp_s = max(stamp_s, self._stamp_s + 1 / self._rate_hz)
        adc_time_s = block.adc_s if block.adc_s > 0 else float("nan")
        return AudioBlock(block.samples[:, self._columns], stamp_s, adc_time_s, block.flags)
