"""The report: what it says, in Chromium and out of it, and the verdict."""

import dataclasses
import errno
import json
import re
import warnings
from pathlib import Path

import html5lib
import numpy as np
import pytest
import yaml
from axe_playwright_python.sync_playwright import Axe
from conftest import make_world, write_measured_session
from playwright.sync_api import Browser, Page, sync_playwright

from calib import outputs
from calib.cli import command
from calib.evidence import arrivals_of_differences
from calib.pipeline import calibrate
from calib.report.names import LABELS
from calib.report.page import report as report_page
from calib.report.plots import COLOURS
from calib.report.residuals import by_buzzer, by_channel, corner_rms_by_pose
from calib.report.verdict import judge
from calib.report.words import command_line, settings_table, short, two_digits, weak_directions
from calib.result import Calibration
from calib.settings import Settings
from rigs.command import run
from rigs.description import RigDescription
from rigs.session.reader import Session

NASTY = "</script><img src=x onerror=alert(1)> \"rig' & /sons"
NAME = "s1 <b>&amp;\"'"
SERIOUS = {"serious", "critical"}


def run_calibrate(*arguments: object) -> int:
    return run("rig-calibrate", command, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def nasty(tmp_path_factory, simulated_description) -> Path:
    """Return the result of a session with hostile names and one bad buzzer, with its report beside it."""
    tdoa_s = make_world(n_poses=12, noise_s=1e-6).problem.tdoa_s.copy()
    tdoa_s[8, :7] += 2e-4  # microphone 1 is late in one emission
    description = simulated_description.model_copy(update={"name": NASTY})
    session = write_measured_session(tmp_path_factory.mktemp("nasty") / f"{NAME}.h5", description, tdoa_s=tdoa_s)
    assert run_calibrate(session, "--suggest-poses", 2) == 0
    return session.with_suffix(".calib.yaml")


@pytest.fixture(scope="module")
def report(nasty) -> Path:
    return nasty.with_name(f"{NAME}.report.html")


@pytest.fixture(scope="module")
def calibrated(nasty) -> tuple[Calibration, RigDescription]:
    with Session.open(nasty.with_name(f"{NAME}.h5")) as session:
        return calibrate(session, Settings()), session.description


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path="/usr/bin/chromium")
        yield chromium
        chromium.close()


@pytest.fixture
def page(browser: Browser, report: Path):
    opened = browser.new_page(viewport={"width": 1280, "height": 900})
    opened.set_default_timeout(20_000)
    opened.goto(report.as_uri())
    yield opened
    opened.close()


def said(page: Page) -> str:
    return re.sub(r"\s+", " ", page.locator("body").inner_text())


def test_html_is_valid(report):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        html5lib.HTMLParser(strict=True).parse(report.read_text())
    ids = re.findall(r'\bid="([^"]*)"', report.read_text())
    assert len(ids) == len(set(ids))
    for reference in re.findall(r'(?:href="#|url\(#|aria-labelledby=")([^")]*)', report.read_text()):
        assert reference in ids


def test_report_needs_no_network_and_names_do_no_harm(browser, report):
    asked, troubles = [], []
    page = browser.new_page()
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("console", lambda line: troubles.append(line.text))
    page.on("dialog", lambda dialog: troubles.append(dialog.message))
    page.goto(report.as_uri())
    page.wait_for_load_state("networkidle")
    assert [url for url in asked if not url.startswith("data:")] == [report.as_uri()]
    assert troubles == []
    assert page.locator("img, h1 b").count() == 0
    assert page.locator("h1").inner_text() == NAME
    assert NASTY in said(page)
    assert report.stat().st_size < 5e6
    page.close()


def test_verdict_comes_first_and_everything_is_told(page, nasty):
    result, words = yaml.safe_load(nasty.read_text()), said(page)
    assert page.locator("main > *").first.get_attribute("class").startswith("verdict")
    assert page.locator("#verdict").inner_text() in {"Good", "Usable", "Do not use"}
    for microphone in result["microphones"]:
        row = page.get_by_role("region", name="Table: Microphones").locator("tbody tr").nth(microphone["channel"] - 1)
        cells = [float(cell) for cell in row.locator("td").all_inner_texts()]
        np.testing.assert_allclose(cells[0:6:2], 1e3 * np.array(microphone["position_m"]), atol=0.0051)
        np.testing.assert_allclose(cells[1:6:2], 1e3 * np.array(microphone["std_m"]), atol=0.0051)
    first, second = (np.array(result["microphones"][row]["position_m"]) for row in (2, 5))
    row = page.get_by_role("region", name="Table: Distances").locator("tbody tr").nth(4)  # of channel 6
    assert row.locator("td").all_inner_texts()[2].startswith(f"{1e3 * np.linalg.norm(first - second):.1f} ± ")
    for suggestion in result["suggested_poses"]:
        assert suggestion in words
    for heading in ("Criteria", "Doubts", "Weakest directions", "Held-out check", "Rejected", "What it cannot tell"):
        assert heading in words
    assert "12 board positions" in words
    assert f"{1e6 * result['held_out']['robust_sigma_s']:.3g} µs" in words
    assert result["session"]["sha256"] in words
    assert "--suggest-poses 2" in words
    assert "acoustic-camera-rig" in words
    assert "Python" in words
    assert page.locator("svg.plot").count() == len(LABELS)


def test_what_was_rejected_is_listed_with_its_reason(page, calibrated):
    (rejected,) = calibrated[0].rejections
    cells = page.get_by_role("region", name="Table: Rejected").locator("tbody tr").first.locator("th, td")
    assert cells.all_inner_texts() == ["arrival", "1", "8", "3", "1", rejected.reason]
    evidence = calibrated[0].evidence
    row, column = np.argwhere(evidence.present & ~evidence.used)[0]
    assert (evidence.pose[row], evidence.buzzer[row], calibrated[0].channels[column]) == (1, 3, 1)
    assert evidence.residuals_s[row, column] == pytest.approx(-2e-4, abs=4e-5)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_serious_finding_of_axe(browser, report, scheme):
    page = browser.new_page(color_scheme=scheme, viewport={"width": 390, "height": 800})
    page.goto(report.as_uri())
    found = Axe().run(page).response["violations"]
    assert [violation["id"] for violation in found if violation["impact"] in SERIOUS] == []
    ground = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    assert (int(re.findall(r"\d+", ground)[0]) > 128) == (scheme == "light")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")  # nothing sticks out of a narrow window
    page.close()


def test_array_turns_by_keyboard_and_buttons(page):
    picture = page.locator("#scene svg")
    start = picture.inner_html()
    page.locator("#scene").focus()
    for key in ("ArrowLeft", "ArrowUp", "+"):
        before = picture.inner_html()
        page.keyboard.press(key)
        assert picture.inner_html() != before
    page.keyboard.press("Home")
    assert picture.inner_html() == start
    page.get_by_role("button", name="Front").click()
    assert picture.inner_html() != start
    assert picture.locator("polygon.board").count() == 12
    page.locator("#with-boards").uncheck()
    assert picture.locator("polygon.board").count() == 0


def test_ellipsoids_are_those_of_the_covariances(page, calibrated):
    """Seen from the front the outline's axes are those of the covariance of x and y, at the scale of the places."""
    result = calibrated[0]
    page.get_by_role("button", name="Front").click()
    page.locator("#exaggeration").select_option("100")
    ellipses = page.locator("#scene ellipse").evaluate_all(
        "all => all.map(e => ['cx', 'cy', 'rx', 'ry', 'transform'].map(name => e.getAttribute(name)))"
    )
    labels = [int(text) for text in page.locator("#scene .microphone text").all_text_contents()]
    drawn = np.array([[float(value) for value in ellipse[:4]] for ellipse in ellipses])[np.argsort(labels)]
    centres_px = drawn[:, :2] - drawn[:, :2].mean(axis=0)
    places_m = result.positions_m[:, :2] - result.positions_m[:, :2].mean(axis=0)
    scale = float(np.sum(centres_px * places_m) / np.sum(places_m**2))
    np.testing.assert_allclose(centres_px, scale * places_m, atol=0.01)
    values, vectors = np.linalg.eigh(result.covariance_m2[:, :2, :2])
    np.testing.assert_allclose(drawn[:, 2:], 100 * 2.7955 * scale * np.sqrt(values[:, ::-1]), rtol=2e-3)
    angles = [float(re.findall(r"[(](\S+) ", ellipses[labels.index(c)][4])[0]) for c in result.channels]
    along = np.column_stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))])
    np.testing.assert_allclose(np.abs(np.sum(along * vectors[:, :, 1], axis=1)), 1, atol=1e-4)


def test_print_and_browsers_without_scripts_get_a_still_picture(browser, report, page):
    assert not page.locator(".still svg").is_visible()
    page.emulate_media(media="print", color_scheme="dark")
    assert page.locator(".still svg").is_visible()
    assert not page.locator("#scene").is_visible()
    paper = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--paper')")
    assert paper.strip() == "#fefefe"  # paper is white, whatever the screen is
    assert page.pdf().startswith(b"%PDF")
    context = browser.new_context(java_script_enabled=False)
    plain = context.new_page()
    plain.goto(report.as_uri())
    assert plain.locator(".still svg").is_visible()
    assert not plain.locator("#scene").is_visible()
    context.close()


def test_scene_is_data_not_script(report):
    scene = re.search(r'id="scene-data">(.*?)</script>', report.read_text(), re.DOTALL)
    assert len(json.loads(scene[1])["microphones"]) == 8


def changed(calibrated: tuple[Calibration, RigDescription], **changes) -> str:
    result = dataclasses.replace(calibrated[0], **({"warnings": []} | changes))
    return judge(result, calibrated[1]).level


def test_verdict_is_that_of_the_worst_criterion(calibrated):
    result = calibrated[0]
    residual, held_out, view = result.residual, result.held_out, result.view
    assert changed(calibrated) == "good"
    assert changed(calibrated, warnings=["a doubt"]) == "usable"
    for std_mm, level in ((1.9, "good"), (2.1, "usable"), (9.9, "usable"), (10.1, "do not use")):
        factor = (1e-3 * std_mm / result.worst_std_m.max()) ** 2
        assert changed(calibrated, array_covariance_m2=factor * result.array_covariance_m2) == level
    assert changed(calibrated, residual=dataclasses.replace(residual, robust_sigma_s=1e-5), held_out=None) == "usable"
    assert (
        changed(calibrated, residual=dataclasses.replace(residual, robust_sigma_s=1e-4), held_out=None) == "do not use"
    )
    assert (
        changed(calibrated, held_out=dataclasses.replace(held_out, robust_sigma_s=2 * residual.robust_sigma_s))
        == "usable"
    )
    assert (
        changed(calibrated, held_out=dataclasses.replace(held_out, robust_sigma_s=4 * residual.robust_sigma_s))
        == "do not use"
    )
    assert changed(calibrated, residual=dataclasses.replace(residual, n_rejected=residual.n_used // 10)) == "usable"
    assert changed(calibrated, residual=dataclasses.replace(residual, n_rejected=residual.n_used)) == "do not use"
    assert changed(calibrated, view=dataclasses.replace(view, rms_px=1.0)) == "usable"
    assert changed(calibrated, view=dataclasses.replace(view, rms_px=2.0)) == "do not use"
    assert changed(calibrated, view=dataclasses.replace(view, board_to_camera=view.board_to_camera[:7])) == "usable"
    facing = [dataclasses.replace(pose, rotation=np.eye(3)) for pose in view.board_to_camera]
    assert changed(calibrated, view=dataclasses.replace(view, board_to_camera=facing)) == "do not use"
    assert changed(calibrated, speed_of_sound_m_s=result.speed_of_sound_m_s + 2.5) == "usable"
    assert changed(calibrated, speed_of_sound_m_s=result.speed_of_sound_m_s + 10) == "do not use"


def test_the_reason_of_the_verdict_is_told_with_its_limit(calibrated):
    result, description = calibrated
    poor = dataclasses.replace(result, view=dataclasses.replace(result.view, rms_px=2.0), warnings=["a doubt"])
    assert judge(poor, description).sentence == (
        "Do not rely on these positions, because of: corners of the board (2 px; usable: ≤ 1.5 px). First: check "
        "focus, and that the board is flat, then capture again."
    )
    sentence = judge(dataclasses.replace(result, warnings=["a doubt"]), description).sentence
    assert "Use them with care, because of: warnings (1; good: none). First: read the warnings" in sentence


def test_weak_directions_are_named(calibrated):
    covariance_m2 = calibrated[0].array_covariance_m2.copy()
    covariance_m2[12:15, 12:15] = np.diag([1e-8, 1e-8, 9e-6])  # of the fifth microphone
    sentences = weak_directions(dataclasses.replace(calibrated[0], array_covariance_m2=covariance_m2))
    assert sentences[0].startswith("The array is known worst in its ")
    assert sentences[1] == "Channel 5: 3 mm in depth (z); 0.1 mm where it is known best."


OTHER_SETTINGS = {
    "method": "ours-2",
    "seed": 1,
    "reference_channel": 2,
    "excluded_channels": (3,),
    "tdoa": "matched",
    "hold": ("speed",),
    "find_delays": True,
    "suggest_poses": 4,
    "ignore_sync": True,
    "exact": ("scale",),
}


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Settings)])
def test_every_setting_is_told_and_part_of_the_command(name):
    changed = dataclasses.replace(Settings(), **{name: OTHER_SETTINGS[name]})
    assert command_line(["s.h5"], "s.yaml", changed) != command_line(["s.h5"], "s.yaml", Settings())
    assert name == "suggest_poses" or settings_table(changed) != settings_table(Settings())


@pytest.mark.parametrize(
    ("value", "words"), [(121.4, "120"), (0.04262, "0.043"), (3.0, "3"), (12345.0, "12000"), (0.0, "0")]
)
def test_numbers_are_short_and_have_no_exponent(value, words):
    assert short(value) == words


@pytest.mark.parametrize(
    ("value", "words"), [(0.0496, "0.050"), (0.0996, "0.10"), (1.96, "2.0"), (49.4, "49"), (121.4, "120"), (0.0, "0")]
)
def test_numbers_side_by_side_have_as_many_digits(value, words):
    assert two_digits(value) == words


def levels(result: Calibration, description: RigDescription) -> dict[str, str]:
    return {criterion.name: criterion.level for criterion in judge(result, description).criteria}


def test_a_picture_seen_in_part_and_one_depth_are_not_good(calibrated):
    result, description = calibrated
    assert levels(result, description)["Picture covered"] == "good"
    corners_px = 0.4 * result.evidence.corners_px
    narrow = dataclasses.replace(result, evidence=dataclasses.replace(result.evidence, corners_px=corners_px))
    assert levels(narrow, description)["Picture covered"] != "good"
    assert "towards the picture's edges" in judge(narrow, description).sentence
    poses = [
        dataclasses.replace(pose, translation_m=np.array([0, 0, 0.7 + 0.01 * number]))
        for number, pose in enumerate(result.view.board_to_camera)
    ]
    flat = dataclasses.replace(result, view=dataclasses.replace(result.view, board_to_camera=poses))
    assert levels(flat, description)["Depth covered"] == "usable"


@pytest.mark.parametrize(("share", "level"), [(0.0, "good"), (0.3, "usable"), (0.6, "do not use")])
def test_what_was_not_heard_counts_as_what_was_rejected(calibrated, share, level):
    """A microphone that heard little is no good, though nothing of it was rejected."""
    result, description = calibrated
    evidence = result.evidence
    residuals_s = evidence.residuals_s.copy()
    residuals_s[: round(share * len(residuals_s)), 2] = np.nan
    deaf = dataclasses.replace(result, evidence=dataclasses.replace(evidence, residuals_s=residuals_s))
    assert levels(deaf, description)["Least heard microphone"] == level


def test_channels_left_out_are_named_and_many_warnings_are_too_many(calibrated):
    result, description = calibrated
    audio = description.audio.model_copy(update={"channels": (*description.audio.channels, 9)})
    more = description.model_copy(update={"audio": audio})
    assert levels(result, more)["Microphones placed"] == "usable"
    assert "8 of 9, without channel 9" in judge(result, more).sentence
    warned = dataclasses.replace(result, warnings=["a doubt"] * 7)
    assert levels(warned, description)["Warnings"] == "do not use"


def test_every_printed_page_has_its_name_verdict_and_number(page, browser, report):
    """Names stand in the style as numbers of their signs: they cannot end it."""
    style = page.locator("style").first.text_content()
    assert "".join(f"\\{ord(sign):06x}" for sign in f"Calibration of {NAME}") in style
    for box in ("@top-left", "@top-right", "@bottom-left", "@bottom-right"):
        assert box in style
    assert "counter(page)" in style
    assert "simulated, not measured" in page.locator(".kind").inner_text().lower()


def test_residuals_are_grouped(calibrated):
    evidence = calibrated[0].evidence
    late = np.where(np.arange(8) == 2, 5e-6, 0.0) + np.zeros_like(evidence.residuals_s)
    shifted = dataclasses.replace(evidence, residuals_s=late, used=np.ones_like(evidence.used))
    groups = by_channel(shifted, calibrated[0].channels)
    assert [round(group.rms_us, 6) for group in groups] == [0, 0, 5, 0, 0, 0, 0, 0]
    assert [group.label for group in by_buzzer(evidence)] == [1, 2, 3, 4, 5, 6]
    assert sum(group.n_used + group.n_rejected for group in by_buzzer(evidence)) == 12 * 6 * 8


def test_corners_are_judged_pose_by_pose(calibrated):
    evidence = calibrated[0].evidence
    residuals_px = np.full_like(evidence.corner_residuals_px, 3.0)
    residuals_px[2], residuals_px[3, 10:] = np.nan, np.nan
    rms_px = corner_rms_by_pose(dataclasses.replace(evidence, corner_residuals_px=residuals_px))
    assert np.isnan(rms_px[2])
    np.testing.assert_allclose(np.delete(rms_px, 2), np.sqrt(18))


def test_residuals_of_pairs_are_shared_out():
    pairs = np.array([(0, 1), (0, 2), (1, 2)], dtype=np.int32)
    arrivals_s = np.array([[1.0, -3.0, 2.0]])
    differences_s = arrivals_s[:, pairs[:, 1]] - arrivals_s[:, pairs[:, 0]]
    np.testing.assert_allclose(arrivals_of_differences(differences_s, pairs, 3), arrivals_s)
    differences_s[0, 1:] = np.nan
    np.testing.assert_allclose(arrivals_of_differences(differences_s, pairs, 3), [[2.0, -2.0, np.nan]])


def test_the_command_makes_the_same_result(nasty, tmp_path, monkeypatch):
    settings = Settings("ours-1", 3, 2, (4, 5))
    words = command_line(["a b.h5"], "c'd.yaml", settings)
    assert words == (
        "rig-calibrate 'a b.h5' --method ours-1 --seed 3 --reference 2 --exclude-channel 4 --exclude-channel 5 "
        "--output 'c'\"'\"'d.yaml'"
    )


def test_papers_method_has_a_report_and_plots_can_be_files(nasty, tmp_path):
    target = tmp_path / "paper.calib.yaml"
    session = nasty.with_name(f"{NAME}.h5")
    assert any(run_calibrate(session, "--method", "ours-2", "--seed", seed, "-o", target, "--plots", "svg") == 0
               for seed in range(6))  # fmt: skip
    text = (tmp_path / "paper.report.html").read_text()
    assert "ours-2 makes no held-out check" in text
    drawn = {path.name for path in tmp_path.glob("*.svg")}
    assert drawn == {f"paper.{name}.svg" for name in LABELS if name != "held-out"}
    assert all(colour in (tmp_path / "paper.array.svg").read_text() for colour in list(COLOURS)[:2])


def test_no_report_is_made_where_none_is_wanted(nasty, tmp_path, capsys):
    session, target = nasty.with_name(f"{NAME}.h5"), tmp_path / "s1.calib.yaml"
    (tmp_path / "s1.report.html").write_text("precious")
    assert run_calibrate(session, "-o", target) == 2
    assert "s1.report.html: already there" in capsys.readouterr().err
    assert run_calibrate(session, "-o", target, "--overwrite") == 2
    assert "not made by this software" in capsys.readouterr().err
    assert not target.exists()
    assert run_calibrate(session, "-o", target, "--no-report", "--plots", "png") == 0
    assert (tmp_path / "s1.report.html").read_text() == "precious"
    assert (tmp_path / "s1.array.png").read_bytes().startswith(b"\x89PNG")


def test_a_full_disk_is_named_and_leaves_neither_result_nor_report(
    tmp_path, simulated_description, monkeypatch, capsys
):
    session = write_measured_session(tmp_path / "s1.h5", simulated_description)

    def full(path: Path, content: bytes, stack: object) -> Path:
        if path.suffix == ".html":
            raise OSError(errno.ENOSPC, "")
        return hidden(path, content, stack)

    hidden = outputs._hidden
    monkeypatch.setattr(outputs, "_hidden", full)
    assert run_calibrate(session) == 2
    assert f"{tmp_path / 's1.report.html'}: No space left" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [session]
    monkeypatch.undo()
    assert run_calibrate(session) == 0


def test_a_long_session_leaves_a_report_of_bearable_size(calibrated, tmp_path, simulated_description):
    """The same poses again and again: the drawings take some of them, and say so."""
    result, _ = calibrated
    evidence, view, n_times = result.evidence, result.view, 40
    many = dataclasses.replace(
        result,
        view=dataclasses.replace(view, pose=np.arange(12 * n_times), board_to_camera=view.board_to_camera * n_times),
        evidence=dataclasses.replace(
            evidence,
            **{
                field.name: np.concatenate([getattr(evidence, field.name)] * n_times)
                for field in dataclasses.fields(evidence)
            },
        ),
    )
    with Session.open(write_measured_session(tmp_path / "s.h5", simulated_description)) as session:
        page = report_page([session], many, Settings(), "s.calib.yaml")
    assert len(page) < 3e6
    assert b"Drawn are 150 of the board positions, 6000 of the corners, 6000 of the residuals" in page
    assert len(json.loads(re.search(rb'id="scene-data">(.*?)</script>', page, re.DOTALL)[1])["boards"]) == 150


def test_a_session_that_was_followed_has_a_report_too(tmp_path, simulated_description):
    session = write_measured_session(tmp_path / "s1.h5", simulated_description)
    assert run_calibrate(session, "--follow", "--export", "csv") == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        "s1.h5", "s1.calib.yaml", "s1.report.html", "s1.microphones.csv"
    }  # fmt: skip


def test_several_sessions_have_one_report(tmp_path, simulated_description):
    for seed, name in enumerate("ab"):
        write_measured_session(tmp_path / f"{name}.h5", simulated_description, seed=seed)
    assert run_calibrate(tmp_path / "a.h5", tmp_path / "b.h5", "--export", "json") == 0
    text = (tmp_path / "a+b.report.html").read_text()
    assert "rig-calibrate a.h5 b.h5 --method joint --output a+b.calib.yaml" in text
    stored = yaml.safe_load((tmp_path / "a+b.calib.yaml").read_text())
    for share in stored["sessions"]:
        assert share["sha256"] in text
    exported = json.loads((tmp_path / "a+b.microphones.json").read_text())
    assert exported["session"]["name"] == "a + b"
    assert run_calibrate(tmp_path / "a+b.calib.yaml", "--export", "json", "--overwrite") == 0


def test_each_of_many_sessions_has_no_exports(tmp_path, simulated_description, capsys):
    session = write_measured_session(tmp_path / "s1.h5", simulated_description)
    assert run_calibrate(session, "--each", "--export", "csv") == 2
    assert "--export from a result afterwards" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [session]
