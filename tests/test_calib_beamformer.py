"""A captured session all the way: to Acoular's beamformer, to a report with its photograph, to README's picture."""

import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_end_to_end import capture_short, shell

from rigs.session.reader import Session

ROOT = Path(__file__).parents[1]
BLOCK, SAMPLES = 512, 4800  # of a sweep of 0.1 s


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    """Return a session beside which stand its result, its report, and Acoular's geometry."""
    path = capture_short(tmp_path_factory.mktemp("heard"), "s1")
    said = shell("rig-calibrate", path, "--export", "acoular,pyroomacoustics", cwd=path.parent)
    assert said.splitlines()[-1] == f"Report: {path.with_suffix('.report.html')}"
    assert re.search("^Verdict: (good|usable). 8 microphones are placed", said, re.MULTILINE)
    return path


@pytest.fixture
def acoular(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Acoular's and its dependencies' own
        import acoular

        acoular.config.global_caching = "none"
        yield acoular


def test_acoulars_beamformer_finds_each_buzzer_within_a_degree(session, acoular):
    microphones = acoular.MicGeom(file=str(session.with_suffix(".acoular.xml")))
    with Session.open(session) as opened:
        emissions, n_buzzers = opened.emissions, len(opened.description.board.buzzers)
    for row in range(0, len(emissions), n_buzzers + 1):  # each buzzer, at a pose of its own
        first = int(emissions[row]["expected_sample"])
        sound = acoular.MaskedTimeSamples(file=str(session), start=first, stop=first + SAMPLES)
        spectra = acoular.PowerSpectra(source=sound, block_size=BLOCK, window="Hanning", overlap="50%")
        rough = acoular.RectGrid3D(x_min=-0.6, x_max=0.6, y_min=-0.4, y_max=0.4, z_min=0.35, z_max=1.2, increment=0.03)
        near = brightest(acoular, microphones, spectra, rough, (1000, 4000))
        reach = np.array((0.03, 0.03, 0.04))
        low, high = near - reach, near + reach
        fine = acoular.RectGrid3D(
            x_min=low[0], x_max=high[0], y_min=low[1], y_max=high[1], z_min=low[2], z_max=high[2], increment=0.005
        )
        found = brightest(acoular, microphones, spectra, fine, (2000, 6000))
        assert angle_deg(found, true_m(session, row)) < 1, f"emission {row}"


def brightest(acoular, microphones, spectra, grid, band_hz: tuple[float, float]) -> np.ndarray:
    """Return the point (3,) of a grid from which most sound comes, summed over a band."""
    steer = acoular.SteeringVector(grid=grid, mics=microphones)
    beamformer = acoular.BeamformerBase(freq_data=spectra, steer=steer, r_diag=True, cached=False)
    frequencies_hz = [hz for hz in spectra.fftfreq() if band_hz[0] <= hz < band_hz[1]]
    total = sum(beamformer.synthetic(hz, 0).ravel() for hz in frequencies_hz)
    return grid.pos[:, np.argmax(total)]


def test_the_page_of_acoular_works(session, acoular, monkeypatch):
    monkeypatch.chdir(session.parent)
    block = (ROOT / "docs/consumers/acoular.md").read_text().split("```python\n")[1].split("```")[0]
    names: dict = {}
    exec(compile(block, "acoular.md", "exec"), names)
    assert names["picture"].shape == (61, 41)
    loudest_m = names["grid"].pos[:, names["picture"].argmax()]
    assert angle_deg(loudest_m, true_m(session, 0)) < 3  # a grid of 2 cm at 0.7 m is 1.6 degrees


def test_the_page_of_pyroomacoustics_works(session, monkeypatch):
    monkeypatch.chdir(session.parent)
    block = (ROOT / "docs/consumers/pyroomacoustics.md").read_text().split("```python\n")[1].split("```")[0]
    names: dict = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(block, "pyroomacoustics.md", "exec"), names)
    azimuth, colatitude = names["finder"].azimuth_recon[0], names["finder"].colatitude_recon[0]
    found = [np.cos(azimuth) * np.sin(colatitude), np.sin(azimuth) * np.sin(colatitude), np.cos(colatitude)]
    assert angle_deg(np.array(found), true_m(session, 0)) < 5  # its grid of directions is as coarse


def true_m(path: Path, emission: int) -> np.ndarray:
    """Return where an emission truly came from, camera frame."""
    with Session.open(path) as session:
        row, truth = session.emissions[emission], session.truth
        numbers = [one.id for one in session.description.board.buzzers]
    to_camera = truth.board_to_camera[row["pose"]]
    return to_camera[:3, :3] @ truth.buzzers_m[numbers.index(row["buzzer"])] + to_camera[:3, 3]


def angle_deg(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.degrees(np.arccos(first @ second / np.linalg.norm(first) / np.linalg.norm(second))))


def test_the_report_shows_a_photograph_and_the_noise_floor(session):
    text = session.with_suffix(".report.html").read_text()
    assert "data:image/jpeg;base64," in text
    assert text.count('class="buzzer"') == 6
    assert text.count('class="corner"') == 54
    assert "The noise in the recording alone gives" in text


def test_readmes_picture_can_be_taken(session, tmp_path):
    picture = tmp_path / "report.png"
    script = ROOT / "docs/figures/screenshot.py"
    subprocess.run([sys.executable, script, session.with_suffix(".report.html"), picture], check=True, timeout=120)
    with Image.open(picture) as taken, Image.open(ROOT / "docs/figures/report.png") as committed:
        assert taken.size == committed.size
        for image in (taken, committed):  # of more than one colour in each quarter: nothing is blank
            width, height = image.size
            for box in ((0, 0), (0, height // 2), (width // 2, 0), (width // 2, height // 2)):
                part = image.convert("RGB").crop((*box, box[0] + width // 2, box[1] + height // 2))
                assert len(part.getcolors(maxcolors=10**6)) > 100
