"""Small sessions, written by the real writer, for the tests of everything that reads them."""

import math

import numpy as np

from rigs.library import parse_description, shipped_rigs
from rigs.session.layout import MeasuredTdoas, Truth
from rigs.session.writer import SessionWriter

TEXT = shipped_rigs()["simulated"]
RIG = parse_description(TEXT, "simulated.yaml")
N_CHANNELS = len(RIG.audio.recorded_channels())
N_CORNERS = RIG.board.corners[0] * RIG.board.corners[1]
BUZZER = RIG.board.buzzers[0].id
BLOCK = 500
TRUTH = Truth(
    np.arange(3.0 * len(RIG.audio.channels)).reshape(-1, 3),
    "simulation",
    343.25,
    np.tile(np.eye(4), (2, 1, 1)),
    np.zeros((len(RIG.board.buzzers), 3)),
    np.eye(3),
    np.zeros(5),
)


def samples(seed=0, n=BLOCK, n_channels=N_CHANNELS):
    return np.random.default_rng(seed).normal(0, 0.1, (n, n_channels)).astype(np.float32)


def picture(seed=0, shape=(48, 64)):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def new_session(path, **changes):
    settings = {
        "name": "sésame",
        "description_text": TEXT,
        "n_channels": N_CHANNELS,
        "sample_rate_hz": RIG.audio.sample_rate_hz,
        "versions": {"software": "acoustic-camera-rig 0.1", "driver": "µ-law 2"},
    }
    return SessionWriter.create(path, **(settings | changes))


def add_pose(writer, pose, accepted=True):
    """Append a pose with two audio blocks, two pictures (gray and colour) and two emissions."""
    for part in range(2):
        seed = 2 * pose + part
        first = writer.append_audio(samples(seed), host_time_s=seed / 100, adc_time_s=math.nan)
        writer.append_frame(picture(seed, (48, 64, 3) if part else (48, 64)), host_time_s=seed / 100, pose=pose)
        writer.append_emission(
            pose=pose,
            buzzer=BUZZER,
            repeat=part,
            waveform="sweep 1000-8000 Hz 0.1 s",
            board_time_s=1.5,
            host_time_s=2.5,
            expected_sample=first + 10,
            accepted=accepted,
            predicted_sample=first + 10.25,
            predicted_std_s=0.001,
            measured_sample=first + 11.0,
            latency_s=0.05,
        )
        writer.append_ping(earliest_host_time_s=2.499, latest_host_time_s=2.501, board_time_s=1.5)
        writer.append_clock_fit(
            clock=b"session",
            since_host_time_s=0.0,
            host_time_s=0.0,
            reading=0.0,
            rate=RIG.audio.sample_rate_hz * (1 + 25e-6),
            rate_std=1e-6,
            std_s=1e-4,
            n_readings=12,
        )
    writer.append_pose(pose=pose, start_host_time_s=1.0, end_host_time_s=2.0, accepted=accepted)


def add_frame_and_emission(writer, pose, expected_sample):
    """Append the picture of a pose and the one emission in it."""
    writer.append_frame(picture(pose), host_time_s=pose + 0.2, pose=pose)
    writer.append_emission(
        pose=pose,
        buzzer=BUZZER,
        repeat=0,
        waveform="sweep",
        board_time_s=pose + 0.3,
        host_time_s=pose + 0.3,
        expected_sample=expected_sample,
        accepted=True,
    )


def write_session(path, n_poses=2, **changes):
    with new_session(path, **changes) as writer:
        for pose in range(n_poses):
            add_pose(writer, pose)
        writer.append_log(3.5, "info", "done")
    return path


def measured(n_poses=2, n_emissions=4):
    pairs = np.array([(RIG.audio.channels[0], channel) for channel in RIG.audio.channels[1:]], dtype=np.int32)
    tdoa_s = np.arange(n_emissions * len(pairs), dtype=float).reshape(n_emissions, -1) * 1e-6
    tdoa_s[0, 0] = np.nan
    corners_px = np.arange(n_poses * N_CORNERS * 2, dtype=float).reshape(n_poses, N_CORNERS, 2)
    corners_px[0, 0] = np.nan
    return {"corners_px": corners_px, "tdoas": MeasuredTdoas(tdoa_s, pairs)}
