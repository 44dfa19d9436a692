"""Whatever is wrong with a session file is named, and nothing in it is followed."""

import hashlib
import os
import shutil
import struct
import zlib

import h5py
import numpy as np
import pytest
from example_sessions import BLOCK, N_CHANNELS, TEXT, TRUTH, measured, new_session, samples, write_session

from rigs.errors import SessionError
from rigs.session import layout
from rigs.session.reader import Session


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return write_session(tmp_path_factory.mktemp("good") / "s.h5", truth=TRUTH, **measured())


@pytest.fixture
def path(good, tmp_path):
    """Return a good session that a test may spoil."""
    return shutil.copy(good, tmp_path / "s.h5")


def refused(path, words):
    with pytest.raises(SessionError, match=words) as caught:
        Session.open(path).close()
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 5


def replaced(file, name, **content):
    attributes = dict(file[name].attrs)
    del file[name]
    file.create_dataset(name, **content)
    file[name].attrs.update(attributes)


def test_missing_file(tmp_path):
    refused(tmp_path / "none.h5", "no such file")


def test_folder(tmp_path):
    refused(tmp_path, "not a file")


def test_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    refused(tmp_path / "pipe", "not a file")


def test_empty_file(tmp_path):
    (tmp_path / "s.h5").touch()
    refused(tmp_path / "s.h5", "empty")


@pytest.mark.parametrize("content", [b"hello", b"hello" * 1000, b"\x89HDF", b"\x89PNG\r\n\x1a\n" + bytes(100)])
def test_not_hdf5(tmp_path, content):
    (tmp_path / "s.h5").write_bytes(content)
    refused(tmp_path / "s.h5", "not an HDF5 file")


@pytest.mark.parametrize("share", [0.001, 0.1, 0.5, 0.9, 0.999])
def test_truncated_file(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: max(12, int(share * len(content)))])
    refused(path, "cut short")


def test_truncated_file_of_a_killed_writer_never_crashes(path):
    content = bytearray(path.read_bytes())
    content[11] |= 0b101  # as a killed writer leaves it
    for share in (0.02, 0.3, 0.6, 0.95):
        path.write_bytes(content[: int(share * len(content))])
        refused(path, "cut short|claims the shape")


def test_scrambled_bytes_never_crash(path):
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(40):
        spoiled = bytearray(content)
        for place in rng.integers(0, 6000, 8):
            spoiled[place] ^= int(rng.integers(1, 256))
        path.write_bytes(spoiled)
        try:
            with Session.open(path) as session:
                session.verify()
        except SessionError as error:
            assert "\n" not in str(error)  # noqa: PT017 - some of them do no harm


def test_foreign_hdf5(tmp_path):
    with h5py.File(tmp_path / "s.h5", "w") as file:
        file["time_data"] = samples()
    refused(tmp_path / "s.h5", "HDF5, but not a session")


@pytest.mark.parametrize("value", ["another", 7, np.arange(3), "acoustic-rig-session"])
def test_foreign_format_attribute(path, value):
    with h5py.File(path, "r+") as file:
        file.attrs["format"] = value  # the last one: of variable length
    refused(path, "not a session|neither short text nor a number")


@pytest.mark.parametrize(("version", "words"), [(layout.VERSION + 1, "update acoustic-camera-rig"), (0, "never|none")])
def test_version(path, version, words):
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = version
    refused(path, words)


_NEEDED = [
    layout.TIME_DATA,
    layout.AUDIO_BLOCKS,
    layout.CAMERA_STREAM,
    layout.CAMERA_FRAMES,
    layout.EMISSIONS,
    layout.POSES,
    layout.LOG,
    layout.DESCRIPTION,
    layout.VERSIONS,
    layout.STATE,
    layout.TDOA_PAIRS,
    "truth/microphones_m",
]


@pytest.mark.parametrize("name", _NEEDED)
def test_missing_dataset(path, name):
    with h5py.File(path, "r+") as file:
        del file[name]
    refused(path, f"{name} is missing")


@pytest.mark.parametrize("name", _NEEDED)
def test_wrong_type(path, name):
    with h5py.File(path, "r+") as file:
        replaced(file, name, data=np.zeros(file[name].shape, dtype="<i2"))
    refused(path, f"{name} is of type int16")


@pytest.mark.parametrize("name", _NEEDED)
def test_wrong_shape(path, name):
    with h5py.File(path, "r+") as file:
        replaced(file, name, data=np.zeros((1, 2, 3), dtype=file[name].dtype))
    refused(path, f"{name} is of shape")


@pytest.mark.parametrize("place", [layout.TIME_DATA, "audio/blocks", "extra", "measured/extra"])
@pytest.mark.parametrize("link", [h5py.SoftLink("/camera/stream"), h5py.ExternalLink("other.h5", "/time_data")])
def test_soft_and_external_links_are_not_followed(path, place, link):
    shutil.copy(path, path.with_name("other.h5"))
    with h5py.File(path, "r+") as file:
        if place in file:
            del file[place]
        file[place] = link
    refused(path, "soft or external link")


def test_external_storage_is_not_read(path, tmp_path):
    (tmp_path / "secret").write_bytes(b"secret!!")
    with h5py.File(path, "r+") as file:
        replaced(file, layout.VERSIONS, shape=(8,), dtype="u1", external=[(str(tmp_path / "secret"), 0, 8)])
    refused(path, "keeps its content in other files")


def test_virtual_dataset_is_not_read(path):
    shutil.copy(path, path.with_name("other.h5"))
    with h5py.File(path, "r+") as file:
        shape = file[layout.TIME_DATA].shape
        mapped = h5py.VirtualLayout(shape=shape, dtype="<f4")
        mapped[:] = h5py.VirtualSource("other.h5", layout.TIME_DATA, shape=shape)
        del file[layout.TIME_DATA]
        file.create_virtual_dataset(layout.TIME_DATA, mapped)
    refused(path, "keeps its content in other files")


@pytest.mark.parametrize("dtype", [h5py.string_dtype(), h5py.vlen_dtype(np.uint8), h5py.ref_dtype])
@pytest.mark.parametrize("name", [layout.LOG, "extra"])
def test_object_types_are_not_read(path, name, dtype):
    with h5py.File(path, "r+") as file:
        if name in file:
            del file[name]
        file.create_dataset(name, shape=(1,), dtype=dtype)
    refused(path, "objects of variable length")


def test_filters_are_refused(path):
    with h5py.File(path, "r+") as file:
        replaced(file, layout.LOG, shape=(1,), dtype=layout.LOG_LINE, compression="gzip")
    refused(path, "filtered or compressed")


@pytest.mark.parametrize("name", [layout.TIME_DATA, "extra"])
def test_absurd_size(path, name):
    with h5py.File(path, "r+") as file:
        if name in file:
            del file[name]
        file.create_dataset(name, shape=(2**50, N_CHANNELS), dtype="<f4", chunks=(64, N_CHANNELS))
    refused(path, "more than a file of")


def test_absurd_chunks(path):
    with h5py.File(path, "r+") as file:
        replaced(file, layout.LOG, shape=(1,), maxshape=(None,), dtype=layout.LOG_LINE, chunks=(2**20,))
    refused(path, "larger than any session")


def test_ring_of_groups_ends(path):
    with h5py.File(path, "r+") as file:
        file["audio/ring"] = file["audio"]
    refused(path, "more than 1000 objects")


def test_seven_channels_where_the_rig_says_eight(tmp_path):
    write_session(tmp_path / "s.h5", n_poses=0, n_channels=7)
    refused(tmp_path / "s.h5", "7 channels where the rig description says 8")


@pytest.mark.parametrize("rate_hz", [44100.0, np.nan, 0.0, "48000"])
def test_other_sample_rate(path, rate_hz):
    with h5py.File(path, "r+") as file:
        value = np.bytes_(rate_hz) if isinstance(rate_hz, str) else rate_hz
        file[layout.TIME_DATA].attrs["sample_freq"] = value
    refused(path, "sample_freq|was sampled at")


def spoil(path, name, row, **values):
    with h5py.File(path, "r+") as file:
        rows = file[name][:]
        for field, value in values.items():
            rows[field][row] = value
        file[name][:] = rows


_CONTRADICTIONS = [
    (layout.AUDIO_BLOCKS, 1, {"first_sample": BLOCK + 1}, "audio block 1 does not follow"),
    (layout.AUDIO_BLOCKS, 2, {"n_samples": -5}, "audio block 2 does not follow"),
    (layout.AUDIO_BLOCKS, 3, {"n_samples": 2**31 - 1}, "audio block 3 does not follow"),
    (layout.AUDIO_BLOCKS, 3, {"n_samples": 10}, "the audio blocks hold 1510 samples, time_data holds 2000"),
    (layout.CAMERA_FRAMES, 3, {"offset": 2**62}, "frame 3 lies outside"),
    (layout.CAMERA_FRAMES, 0, {"offset": -1}, "frame 0 lies outside"),
    (layout.CAMERA_FRAMES, 1, {"length": 2**63 - 1}, "frame 1 lies outside"),
    (layout.CAMERA_FRAMES, 1, {"length": 0}, "frame 1 lies outside"),
    (layout.EMISSIONS, 2, {"buzzer": 99}, "emission 2 names buzzer 99"),
    (layout.EMISSIONS, 1, {"pose": 7}, "emission 1 names pose 7"),
    (layout.EMISSIONS, 1, {"pose": -1}, "emission 1 names pose -1"),
    (layout.POSES, 0, {"pose": -1}, "row 0 of poses"),
]


@pytest.mark.parametrize(("name", "row", "values", "words"), _CONTRADICTIONS)
def test_contradiction_is_named(path, name, row, values, words):
    spoil(path, name, row, **values)
    refused(path, words)


def test_cut_off_recording_leaves_out_rows_that_never_reached_the_disk(tmp_path):
    path = write_session(tmp_path / "s.h5")
    spoil(path, layout.AUDIO_BLOCKS, slice(2, 4), first_sample=0, n_samples=0)
    spoil(path, layout.CAMERA_FRAMES, 3, offset=0, length=0)
    with h5py.File(path, "r+") as file:
        file[layout.STATE][0] = layout.STATE_OPEN
        del file[layout.CHECKSUMS]  # a session that was cut off has none of its tables
    with Session.open(path) as session:
        assert session.n_samples == 2 * BLOCK
        assert len(session.frames) == 3
        assert [remark.partition(":")[0] for remark in session.remarks] == [
            "audio block 2 does not follow the one before in time_data",
            f"frame 3 lies outside of camera/stream ({session._pictures.shape[0]} bytes)",
        ]
        assert session.verify() == session.remarks


def test_emissions_of_the_pose_under_way_are_kept(path):
    with h5py.File(path, "r+") as file:
        file[layout.POSES].resize(1, axis=0)
        del file["measured"]
    with Session.open(path) as session:
        assert len(session.emissions) == 4


@pytest.mark.parametrize(("name", "table"), [(layout.CORNERS, "poses"), (layout.TDOAS, "emissions")])
def test_measured_rows_must_fit(path, name, table):
    with h5py.File(path, "r+") as file:
        replaced(file, name, data=file[name][:-1])
    refused(path, f"{name} has . rows")


def test_tdoas_of_unknown_channels(path):
    with h5py.File(path, "r+") as file:
        file[layout.TDOA_PAIRS][0, 1] = 77
    refused(path, "channels that the rig does not record")


def test_changed_description(path):
    with h5py.File(path, "r+") as file:
        file[layout.DESCRIPTION][0] ^= 1
    refused(path, "changed after recording")


@pytest.mark.parametrize(("content", "words"), [(b"name: [", "rig description"), (b"\xff\xfe\xff", "not UTF-8")])
def test_bad_description(path, content, words):
    with h5py.File(path, "r+") as file:
        replaced(file, layout.DESCRIPTION, data=np.frombuffer(content, dtype=np.uint8))
        file[layout.DESCRIPTION].attrs["sha256"] = np.bytes_(hashlib.sha256(content).hexdigest())
    refused(path, words)


@pytest.mark.parametrize("listing", [b"", b"[]", b'{"a": 1}', b"[" * 100_000, b"\xff"])
def test_bad_versions(path, listing):
    with h5py.File(path, "r+") as file:
        replaced(file, layout.VERSIONS, data=np.frombuffer(listing, dtype=np.uint8))
    refused(path, "not a JSON object of texts")


def test_damaged_audio_and_pictures_are_found(path):
    with h5py.File(path, "r+") as file:
        file[layout.TIME_DATA][BLOCK + 3, 2] += 1
        file[layout.CAMERA_STREAM][60] ^= 1
    with Session.open(path) as session:
        assert session.verify() == [
            "audio block 1 is damaged: its checksum does not fit",
            "frame 0 is damaged: its checksum does not fit",
        ]
        with pytest.raises(SessionError, match="frame 0 is damaged"):
            session.picture(0)
        assert session.picture(1).shape == (48, 64, 3)


def test_samples_that_are_not_numbers_are_found(tmp_path):
    spoiled = samples()
    spoiled[3, 4] = np.nan
    with new_session(tmp_path / "s.h5") as writer:
        writer.append_audio(spoiled, host_time_s=0.0, adc_time_s=0.0)
    with Session.open(tmp_path / "s.h5") as session:
        assert session.verify() == ["audio block 0 holds samples that are not numbers"]


def png_header(width, height, depth=8, colour=0):
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", width, height, depth, colour, 0, 0, 0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (png_header(2**31 - 1, 2**31 - 1), "claims"),
        (png_header(16000, 16000), "claims 16000 x 16000"),
        (png_header(0, 10), "claims"),
        (png_header(64, 64, depth=16), "8 bits"),
        (png_header(64, 64, colour=6), "8 bits"),
        (png_header(64, 64), "cannot decode"),
        (b"GIF89a" + bytes(80), "not a PNG"),
    ],
)
def test_insane_pictures_are_not_decoded(path, content, words):
    content = np.frombuffer(content.ljust(80, b"\0"), dtype=np.uint8)
    with h5py.File(path, "r+") as file:
        file[layout.CAMERA_STREAM][: len(content)] = content
    spoil(path, layout.CAMERA_FRAMES, 0, length=len(content), crc32=zlib.crc32(content.tobytes()))
    with Session.open(path) as session, pytest.raises(SessionError, match=words):
        session.picture(0)


def test_description_is_kept_word_for_word(tmp_path):
    text = TEXT + "\n# a comment at the end: µ"
    with Session.open(write_session(tmp_path / "s.h5", description_text=text)) as session:
        assert session.description_text == text


@pytest.mark.parametrize("name", [*layout.TABLES, layout.VERSIONS, layout.CORNERS, layout.TDOAS, "truth/microphones_m"])
def test_a_changed_table_or_layer_is_found(path, name):
    with h5py.File(path, "r+") as file:
        rows = file[name][:]
        content = rows.view(np.uint8).reshape(-1)
        content[3 if name == layout.VERSIONS else -1] ^= 1
        file[name][:] = rows
    with Session.open(path) as session:
        assert f"{name} is damaged: its checksum does not fit" in session.verify()


def test_a_session_without_checksums_is_read(path):
    with h5py.File(path, "r+") as file:
        del file[layout.CHECKSUMS]
    with Session.open(path) as session:
        assert session.verify() == []
