"""The session file's layout: every name, shape, dtype and unit, said once (told in words in FORMAT.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FORMAT = "acoustic-rig-session"
VERSION = 1

# Names of datasets. Root attributes: format, version, name, created_utc, file_id, and recovered where it was.
TIME_DATA = "time_data"  # (n_samples, n_channels) float32, full scale = 1; attribute sample_freq in hertz
AUDIO_BLOCKS = "audio/blocks"  # (n_blocks,) AUDIO_BLOCK
CAMERA_STREAM = "camera/stream"  # (n_bytes,) uint8: PNG pictures, one after another
CAMERA_FRAMES = "camera/frames"  # (n_frames,) FRAME
EMISSIONS = "emissions"  # (n_emissions,) EMISSION
ONSETS = "emissions_onset"  # optional (n_emissions,) ONSET, a row per row of emissions
PINGS = "clock/pings"  # optional (n_pings,) PING
CLOCK_FITS = "clock/fits"  # optional (n_fits,) CLOCK_FIT
POSES = "poses"  # (n_poses,) POSE
LOG = "log"  # (n_lines,) LOG_LINE
DESCRIPTION = "rig/description"  # (n_bytes,) uint8: the YAML word for word; attribute sha256
VERSIONS = "rig/versions"  # (n_bytes,) uint8: JSON object of strings: software, firmware, drivers
CHECKSUMS = "checksums"  # optional (n,) CHECKSUM, of tables and of what does not grow
STATE = "state"  # (1,) uint8: STATE_OPEN while recording, STATE_CLOSED after a good end
TRUTH = "truth"  # optional group, see Truth
CORNERS = "measured/corners"  # optional (n_poses, n_corners, 2) float64 pixels, NaN where not found
TDOAS = "measured/tdoas"  # optional (n_emissions, n_pairs) float64 seconds, NaN where missing
TDOA_PAIRS = "measured/pairs"  # (n_pairs, 2) int32 input channels (i, j): arrival at j minus arrival at i

STATE_OPEN = 0
STATE_CLOSED = 1

# Times named host_time_s are the host's monotonic clock; board_time_s the trigger board's own clock.
AUDIO_BLOCK = np.dtype(
    [
        ("first_sample", "<i8"),  # row of time_data where the block begins
        ("n_samples", "<i4"),
        ("host_time_s", "<f8"),  # when the block's first sample was taken, as the host reckons
        ("adc_time_s", "<f8"),  # the driver's own time of it; NaN where it has none
        ("flags", "<u4"),  # FLAG_*
        ("crc32", "<u4"),  # of the block's float32 bytes
    ]
)
FRAME = np.dtype(
    [
        ("offset", "<i8"),  # first byte in camera/stream
        ("length", "<i8"),  # bytes
        ("host_time_s", "<f8"),
        ("pose", "<i4"),
        ("crc32", "<u4"),  # of the PNG's bytes
    ]
)
EMISSION = np.dtype(
    [
        ("pose", "<i4"),
        ("buzzer", "<i4"),  # id as in the rig description
        ("repeat", "<i4"),
        ("waveform", "S64"),
        ("board_time_s", "<f8"),
        ("host_time_s", "<f8"),
        ("expected_sample", "<i8"),  # row of time_data where the emission should begin; -1: unknown
        ("accepted", "u1"),
    ]
)
ONSET = np.dtype(
    [
        ("predicted_sample", "<f8"),  # from the board's ON event, the clocks and the latency; NaN: unknown
        ("predicted_std_s", "<f8"),  # standard deviation of the prediction
        ("measured_sample", "<f8"),  # where it begins in the sound: median over the channels; NaN: not heard
        ("latency_s", "<f8"),  # of the audio path, within the prediction; NaN: not learnt yet
    ]
)
PING = np.dtype(
    [
        ("earliest_host_time_s", "<f8"),  # the board's clock was read between these two
        ("latest_host_time_s", "<f8"),
        ("board_time_s", "<f8"),
    ]
)
CLOCK_FIT = np.dtype(
    [
        ("clock", "S8"),  # CLOCK_*
        ("since_host_time_s", "<f8"),  # of the first reading it rests on
        ("host_time_s", "<f8"),  # a point of the line: when the clock read `reading`
        ("reading", "<f8"),  # a row of time_data, or seconds
        ("rate", "<f8"),  # of the clock, per second of the host
        ("rate_std", "<f8"),  # standard deviation of the rate, as a share of it
        ("std_s", "<f8"),  # standard deviation of a host time by this line
        ("n_readings", "<i4"),
    ]
)
POSE = np.dtype(
    [
        ("pose", "<i4"),
        ("start_host_time_s", "<f8"),
        ("end_host_time_s", "<f8"),
        ("accepted", "u1"),
    ]
)
LOG_LINE = np.dtype([("host_time_s", "<f8"), ("level", "S8"), ("text", "S240")])
CHECKSUM = np.dtype(
    [
        ("name", "S64"),  # of the dataset
        ("n_rows", "<i8"),  # -1: not known, as the session was never closed
        ("crc32", "<u4"),  # of its bytes
    ]
)

# Every table that grows, in the order in which it is flushed: what is pointed to comes first.
TABLES: dict[str, np.dtype[np.void]] = {
    AUDIO_BLOCKS: AUDIO_BLOCK,
    CAMERA_FRAMES: FRAME,
    PINGS: PING,
    CLOCK_FITS: CLOCK_FIT,
    POSES: POSE,
    ONSETS: ONSET,
    EMISSIONS: EMISSION,
    LOG: LOG_LINE,
}
OPTIONAL_TABLES = (PINGS, CLOCK_FITS, ONSETS)  # that older sessions do not have

CLOCK_AUDIO = b"audio"  # rows of time_data, by the stamps of audio/blocks; as used for the emission stored next
CLOCK_BOARD = b"board"  # board_time_s, by clock/pings; as used for the emission stored next
CLOCK_CAMERA = b"camera"  # host_time_s of a frame, whose delay is unknown
CLOCK_SESSION = b"session"  # as audio, by all stamps of the longest stretch without a break

FLAG_OVERFLOW = 1  # the driver says samples before this block were lost
FLAG_GAP = 2  # the clock says so
FLAG_RESUMED = 4  # a later run begins here: host and board times before and after are not comparable
FLAG_SILENCED = 8  # the block was damaged; silence of the same length stands in its place


@dataclass(frozen=True)
class Truth:
    """What is known to be true, for evaluation only; calibration never starts from it.

    Parameters
    ----------
    microphones_m : (n_mics, 3) array
        Camera frame, in the order of the rig's channels.
    speed_of_sound_m_s : float or None
    board_to_camera : (n_poses, 4, 4) array or None
    buzzers_m : (n_buzzers, 3) array or None
        Board frame, in the order of the rig description.
    camera_matrix : (3, 3) array or None
    distortion : (5,) array or None
    source : str
        Where the truth comes from ("simulation", "ruler").
    """

    microphones_m: NDArray[np.float64]
    source: str
    speed_of_sound_m_s: float | None = None
    board_to_camera: NDArray[np.float64] | None = None
    buzzers_m: NDArray[np.float64] | None = None
    camera_matrix: NDArray[np.float64] | None = None
    distortion: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class MeasuredTdoas:
    """TDOAs that a session begins with.

    Parameters
    ----------
    tdoa_s : (n_emissions, n_pairs) array
        Arrival at j minus arrival at i in seconds; NaN where missing. Rows as in the emissions table.
    pairs : (n_pairs, 2) integer array
        Input channels (i, j) of each column.
    """

    tdoa_s: NDArray[np.float64]
    pairs: NDArray[np.int32]
