"""What is written to a session is what is read, by this project and by others."""

import hashlib
import json
import math
import signal
import subprocess
import sys
import warnings
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from example_sessions import (
    BLOCK,
    BUZZER,
    N_CHANNELS,
    RIG,
    TEXT,
    TRUTH,
    add_pose,
    measured,
    new_session,
    picture,
    samples,
    write_session,
)

from rigs.errors import SessionError, TargetError, TargetExistsError
from rigs.session import layout
from rigs.session.info import summary
from rigs.session.reader import Session


@pytest.fixture
def path(tmp_path):
    return tmp_path / "s.h5"


def test_session_roundtrips_identity_and_description(path):
    write_session(path)
    with Session.open(path) as session:
        assert session.name == "sésame"
        assert session.created_utc.endswith("+00:00")
        assert session.complete
        assert session.description == RIG
        assert session.description_text == TEXT
        assert session.description_sha256 == hashlib.sha256(TEXT.encode()).hexdigest()
        assert session.versions == {"software": "acoustic-camera-rig 0.1", "driver": "µ-law 2"}
        assert session.channels == RIG.audio.recorded_channels()
        assert session.sha256() == hashlib.sha256(path.read_bytes()).hexdigest()


def test_session_roundtrips_audio(path):
    write_session(path)
    wanted = np.concatenate([samples(seed) for seed in range(4)])
    with Session.open(path) as session:
        assert (session.n_samples, session.n_channels) == (4 * BLOCK, N_CHANNELS)
        assert session.sample_rate_hz == RIG.audio.sample_rate_hz
        np.testing.assert_array_equal(session.audio(0, session.n_samples), wanted)
        across = session.audio(BLOCK - 7, 20)
        np.testing.assert_array_equal(across, wanted[BLOCK - 7 : BLOCK + 13])
        assert across.dtype == np.float32
        assert session.audio_blocks["first_sample"].tolist() == [0, BLOCK, 2 * BLOCK, 3 * BLOCK]
        assert session.audio_blocks["crc32"][1] == zlib.crc32(wanted[BLOCK : 2 * BLOCK].tobytes())
        assert math.isnan(session.audio_blocks["adc_time_s"][0])


def test_session_roundtrips_pictures_losslessly(path):
    write_session(path)
    with Session.open(path) as session:
        np.testing.assert_array_equal(session.picture(0), picture(0))
        np.testing.assert_array_equal(session.picture(3), picture(3, (48, 64, 3)))
        assert session.frames["pose"].tolist() == [0, 0, 1, 1]


def test_session_roundtrips_tables(path):
    write_session(path)
    with Session.open(path) as session:
        last = session.emissions[-1]
        assert last.tolist() == (1, BUZZER, 1, b"sweep 1000-8000 Hz 0.1 s", 1.5, 2.5, 3 * BLOCK + 10, 1)
        assert session.poses.tolist() == [(0, 1.0, 2.0, 1), (1, 1.0, 2.0, 1)]
        assert session.log.tolist() == [(3.5, b"info", b"done")]
        assert session.verify() == []


def test_session_roundtrips_truth(path):
    write_session(path, truth=TRUTH)
    with Session.open(path) as session:
        assert session.truth.source == "simulation"
        assert session.truth.speed_of_sound_m_s == 343.25
        for name in ("microphones_m", "board_to_camera", "buzzers_m", "camera_matrix", "distortion"):
            np.testing.assert_array_equal(getattr(session.truth, name), getattr(TRUTH, name))


def test_truth_may_be_partial(path):
    write_session(path, truth=layout.Truth(TRUTH.microphones_m, "ruler"))
    with Session.open(path) as session:
        assert session.truth.source == "ruler"
        assert session.truth.speed_of_sound_m_s is None
        assert session.truth.board_to_camera is None


def test_session_may_begin_at_measured_layers(path):
    layers = measured(n_poses=1, n_emissions=1)
    with new_session(path, **layers) as writer:
        writer.append_emission(
            pose=0,
            buzzer=BUZZER,
            repeat=0,
            waveform="w",
            board_time_s=math.nan,
            host_time_s=math.nan,
            expected_sample=-1,
            accepted=True,
        )
        writer.append_pose(pose=0, start_host_time_s=math.nan, end_host_time_s=math.nan, accepted=True)
    with Session.open(path) as session:
        assert (session.n_samples, len(session.frames)) == (0, 0)
        assert session.audio(0, 0).shape == (0, N_CHANNELS)
        np.testing.assert_array_equal(session.corners_px, layers["corners_px"])
        np.testing.assert_array_equal(session.tdoas.tdoa_s, layers["tdoas"].tdoa_s)
        np.testing.assert_array_equal(session.tdoas.pairs, layers["tdoas"].pairs)
        assert session.truth is None


def test_acoular_reads_a_session(path, monkeypatch):
    monkeypatch.chdir(path.parent)  # Acoular may make a folder for its cache
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "We detected that Numpy is already loaded", UserWarning)
        import acoular
    write_session(path)
    source = acoular.TimeSamples(file=str(path))
    assert source.sample_freq == RIG.audio.sample_rate_hz
    assert (source.num_samples, source.num_channels) == (4 * BLOCK, N_CHANNELS)
    read = np.concatenate([block.copy() for block in source.result(128)])
    np.testing.assert_array_equal(read, np.concatenate([samples(seed) for seed in range(4)]))


def test_plain_h5py_reads_a_session_without_variable_length_types(path):
    write_session(path, truth=TRUTH, **measured())
    with h5py.File(path) as file:
        assert file.attrs["format"] == layout.FORMAT.encode()
        assert json.loads(file[layout.VERSIONS][:].tobytes())["driver"] == "µ-law 2"
        kinds = []
        file.visititems(lambda _, item: kinds.append(getattr(item, "dtype", None)))
        assert not any(kind.hasobject for kind in kinds if kind is not None)


def test_log_text_is_cut_between_letters(path):
    with new_session(path) as writer:
        writer.append_log(0.0, "warning!!", "é" * 119 + "xyé")
    with Session.open(path) as session:
        assert session.log["text"][0].decode() == "é" * 119 + "xy"
        assert session.log["level"][0] == b"warning!"


def test_growing_session_is_read_as_far_as_flushed(path):
    with new_session(path) as writer:
        add_pose(writer, 0)
        writer.flush()
        add_pose(writer, 1)
        with Session.open(path) as session:
            assert not session.complete
            assert session.n_samples == 2 * BLOCK
            assert len(session.frames) == 2
            assert len(session.poses) == 1
            assert session.verify() == []
    with Session.open(path) as session:
        assert session.complete
        assert session.n_samples == 4 * BLOCK


def test_writer_flushes_every_second_of_audio(path):
    with new_session(path) as writer:
        writer.append_audio(samples(n=int(RIG.audio.sample_rate_hz)), host_time_s=0.0, adc_time_s=0.0)
        with Session.open(path) as session:
            assert session.n_samples == RIG.audio.sample_rate_hz


_KILLED = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from example_sessions import add_pose, new_session
writer = new_session(Path({path!r}))
for pose in range(3):
    add_pose(writer, pose)
writer.flush()
add_pose(writer, 3)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_killed_writer_leaves_everything_flushed(path):
    code = _KILLED.format(tests=str(Path(__file__).parent), path=str(path))
    killed = subprocess.run([sys.executable, "-c", code], check=False)
    assert killed.returncode == -signal.SIGKILL
    with Session.open(path) as session:
        assert not session.complete
        assert session.n_samples == 6 * BLOCK
        assert session.poses["pose"].tolist() == [0, 1, 2]
        np.testing.assert_array_equal(session.audio(5 * BLOCK, BLOCK), samples(5))
        np.testing.assert_array_equal(session.picture(5), picture(5, (48, 64, 3)))
        assert session.verify() == []


_FULL_DISK = """
import resource, signal, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from example_sessions import new_session, samples
from rigs.errors import SessionError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
writer = new_session(Path({path!r}))
try:
    with writer:
        for _ in range(1000):
            writer.append_audio(samples(), host_time_s=0.0, adc_time_s=0.0)
            writer.flush()
except SessionError as error:
    print(error)
writer.close()
"""


def test_full_disk_is_one_clear_line_and_keeps_what_was_flushed(path):
    code = _FULL_DISK.format(tests=str(Path(__file__).parent), path=str(path))
    ended = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "cannot be written (File too large)" in ended.stdout
    with Session.open(path) as session:
        assert not session.complete
        assert session.n_samples >= 40 * BLOCK
        assert session.verify() == []


def test_exception_leaves_a_good_but_incomplete_session(path):
    def record_and_be_interrupted():
        with new_session(path) as writer:
            add_pose(writer, 0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_and_be_interrupted()
    with Session.open(path) as session:
        assert not session.complete
        assert session.n_samples == 2 * BLOCK


@pytest.mark.parametrize("make", [Path.touch, Path.mkdir, lambda path: path.symlink_to("nowhere"), write_session])
def test_existing_target_is_refused(path, make):
    make(path)
    before = path.read_bytes() if path.is_file() else None
    with pytest.raises(TargetExistsError, match="already something"):
        new_session(path)
    assert before is None or path.read_bytes() == before


def test_target_of_a_living_writer_is_refused(path):
    with new_session(path) as writer, pytest.raises(TargetExistsError):
        new_session(path)
    assert writer.n_samples == 0
    Session.open(path).close()


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(TargetError, match="there is no folder"):
        new_session(tmp_path / "none" / "s.h5")


def test_failed_creation_leaves_nothing(path):
    with pytest.raises(ValueError, match="could not convert"):
        new_session(path, corners_px="no corners")
    assert not path.exists()


def test_misfits_are_refused_and_do_no_harm(path):
    with new_session(path) as writer:
        with pytest.raises(SessionError, match=f"does not fit a session of {N_CHANNELS} channels"):
            writer.append_audio(samples(n_channels=7), host_time_s=0.0, adc_time_s=0.0)
        with pytest.raises(SessionError, match="cannot be stored"):
            writer.append_frame(np.zeros((4, 4), dtype=np.float32), host_time_s=0.0, pose=0)
        add_pose(writer, 0)
    with pytest.raises(SessionError, match="closed"):
        writer.append_log(0.0, "info", "late")
    writer.close()
    with Session.open(path) as session:
        assert session.verify() == []
        assert session.n_samples == 2 * BLOCK


def test_what_a_session_does_not_hold_is_said(path):
    write_session(path)
    with Session.open(path) as session:
        for first, n in ((-1, 10), (0, -1), (4 * BLOCK - 1, 2), (2**62, 2**62)):
            with pytest.raises(SessionError, match="the session holds 0 to 2000"):
                session.audio(first, n)
        for index in (-1, 4):
            with pytest.raises(SessionError, match="the session holds 4"):
                session.picture(index)


def test_clocks_and_onsets_come_back_as_written(tmp_path):
    with Session.open(write_session(tmp_path / "s.h5")) as session:
        assert session.onsets[-1]["predicted_sample"] == session.emissions["expected_sample"][-1] + 0.25
        assert len(session.onsets) == len(session.emissions) == len(session.pings) == 4
        assert session.pings[0].tolist() == (2.499, 2.501, 1.5)
        assert session.clock_fits[0]["clock"] == layout.CLOCK_SESSION
        assert dict(summary(session))["clock"] == "sampled at 48001.20 Hz, +25.0 +- 1.0 ppm"


def test_a_session_of_before_the_clocks_is_read(tmp_path):
    path = write_session(tmp_path / "s.h5")
    with h5py.File(path, "r+") as file:
        del file[layout.CHECKSUMS]
        for name in layout.OPTIONAL_TABLES:
            del file[name]
    with Session.open(path) as session:
        assert session.onsets is None
        assert len(session.pings) == len(session.clock_fits) == 0
        assert "clock" not in dict(summary(session))
