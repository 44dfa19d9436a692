"""From capture to verification with real sound and pictures, as a user runs it, on a rig that is met again later."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from test_end_to_end import capture_short, shell

from calib.verification.film import CODECS, write_film
from calib.verification.overlay import BAR_LINES, bar_px
from rigs.session.reader import Session

MOVED = {"visit": 1, "faults": [{"kind": "moved_channel", "channel": 4}]}


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """Return a folder with a calibrated session, and one of a later visit with microphone 4 moved."""
    folder = tmp_path_factory.mktemp("bench")
    capture_short(folder, "s1", simulation={"rt60_s": 0.2})
    shell("rig-calibrate", "s1.h5", cwd=folder)
    capture_short(folder, "s2", simulation={"rt60_s": 0.2} | MOVED, capture={"poses": 5})
    return folder


def figures(folder: Path) -> dict:
    return yaml.safe_load((folder / "verification.yaml").read_text())


def redness(picture: np.ndarray) -> float:
    """Return how much more red than green the last line of words is."""
    line = picture[-bar_px(picture.shape[1]) // BAR_LINES :].astype(float)
    return float((line[..., 2] - line[..., 1]).mean())


def test_held_out_poses_of_a_session(bench):
    said = shell("rig-verify", "s1.h5", "--calibration", "s1.calib.yaml", cwd=bench)
    found = figures(bench / "s1.verify")
    assert said.startswith("PASS")
    assert "film overlay.mp4" in said
    assert found["n_located"] == found["n_emissions"] == 18
    assert found["errors"]["picture_px"]["median"] < 0.75  # half of 1.5 px: these pictures are half as wide
    assert found["errors"]["space_m_per_m"]["median"] < 0.003
    assert found["errors"]["steered_px"]["median"] < 2.0
    assert found["movement"]["moved"] == []


def test_the_pictures_show_what_was_found(bench):
    if not (bench / "s1.verify").exists():
        shell("rig-verify", "s1.h5", "--calibration", "s1.calib.yaml", cwd=bench)
    folder = bench / "s1.verify"
    found = figures(folder)
    poses = sorted({one["pose"] for one in found["emissions"]})
    assert sorted(path.name for path in folder.glob("*.png")) == [f"pose-{pose:03d}.png" for pose in poses]
    with Session.open(bench / "s1.h5") as session:
        photo = session.picture(int(np.flatnonzero(session.frames["pose"] == poses[0])[0]))
    picture = cv2.imread(str(folder / f"pose-{poses[0]:03d}.png"))
    assert picture.shape == (photo.shape[0] + bar_px(photo.shape[1]), photo.shape[1], 3)
    assert redness(picture) < -1  # the verdict: passed
    warmth = picture[: photo.shape[0], :, 2].astype(float) - picture[: photo.shape[0], :, 0]  # red over blue
    for one in found["emissions"][:6]:
        x, y = (round(value) for value in one["seen_px"])
        assert warmth[max(y - 15, 0) : y + 15, max(x - 15, 0) : x + 15].max() > 80  # the map's heat
    assert np.median(np.abs(warmth)) < 3  # elsewhere the photo, gray as it was
    film = cv2.VideoCapture(str(folder / "overlay.mp4"))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == found["n_emissions"]
    assert film.read()[1].shape == picture.shape
    assert found["film"]["codec"] in CODECS.values()


def test_a_moved_microphone_is_named(bench):
    said = shell("rig-verify", "s2.h5", "--calibration", "s1.calib.yaml", cwd=bench, exit_code=5)
    assert said.startswith("FAIL array moved: microphone 4 by ")
    (moved,) = figures(bench / "s2.verify")["movement"]["moved"]
    assert moved["what"] == 4
    assert all(redness(cv2.imread(str(path))) > 1 for path in (bench / "s2.verify").glob("*.png"))
    assert abs(np.linalg.norm(moved["shift_m"]) - 0.003) < 3 * moved["std_m"] + 0.0002


def test_a_codec_that_is_not_there_is_passed_over(tmp_path, monkeypatch):
    scenes = [np.full((48, 64, 3), 40 * number, np.uint8) for number in range(4)]
    monkeypatch.setattr("calib.verification.film.CODECS", {"hvc1": "none here", "mp4v": "MPEG-4 part 2"})
    assert write_film(tmp_path / "a.mp4", scenes, (64, 48)) == "MPEG-4 part 2"
    monkeypatch.setattr("calib.verification.film.CODECS", {"hvc1": "none here"})
    assert write_film(tmp_path / "b.mp4", scenes, (64, 48)) is None


def test_a_damaged_photo_leaves_nothing_behind(bench, tmp_path):
    session = Path(shutil.copy(bench / "s2.h5", tmp_path / "s3.h5"))
    with Session.open(session) as opened:
        frames = np.flatnonzero(opened.frames["pose"] == 0)
        png = opened.png(int(frames[len(frames) // 2])).tobytes()
    piece, content = png[1000:1064], session.read_bytes()
    assert content.count(piece) == 1
    session.write_bytes(content.replace(piece, bytes(64)))
    said = shell("rig-verify", "s3.h5", "--calibration", bench / "s1.calib.yaml", cwd=tmp_path, exit_code=5)
    assert "checksum does not fit" in said
    assert not list(tmp_path.glob("*verify*"))
    assert not list(tmp_path.glob(".s3.verify*"))
