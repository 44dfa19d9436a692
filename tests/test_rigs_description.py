"""What a rig description accepts, and the one line that each mistake gets."""

import math

import pytest

from rigs.description import Intrinsics
from rigs.errors import DescriptionError
from rigs.library import parse_description, shipped_rigs

TEMPLATE = shipped_rigs()["bench8"]


def complaint(text: str) -> str:
    with pytest.raises(DescriptionError) as caught:
        parse_description(text, "rig.yaml")
    return str(caught.value)


def changed(old: str, new: str) -> str:
    assert old in TEMPLATE
    return TEMPLATE.replace(old, new, 1)


@pytest.mark.parametrize("name", ["simulated", "kinect8", "bench8", "virtual"])
def test_every_shipped_rig_is_valid_and_tells_editors_its_schema(name):
    text = shipped_rigs()[name]
    assert parse_description(text, name).name == name
    assert text.startswith("# yaml-language-server: $schema=rig.schema.json\n")


def test_the_template_shows_the_default_of_every_optional_key():
    shown = parse_description(TEMPLATE, "bench8.yaml")
    left_out = parse_description(TEMPLATE[: TEMPLATE.index("capture:")], "bench8.yaml")
    assert shown.capture == left_out.capture
    assert shown.calibration == left_out.calibration


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        (
            "square_size_m: 0.025",
            "square_size_mm: 25",
            "board.square_size_mm: unknown key; did you mean square_size_m (in metres)?",
        ),
        (
            "square_size_m: 0.025",
            "squaresize_m: 0.025",
            "board.squaresize_m: unknown key; did you mean square_size_m (in",
        ),
        ("medium:", "medum:", "medum: unknown key; did you mean medium?"),
        ("repeats: 1", "colour: red", "signal.colour: unknown key; known here: duration_s, gap_s, kind, repeats"),
        (
            "square_size_m: 0.025",
            "square_size_m: 25",
            "board.square_size_m: 25 is more than 0.5: give metres, e.g. 0.025 for 25 mm",
        ),
        (
            "sample_rate_hz: 48000",
            "sample_rate_hz: 48",
            "audio.sample_rate_hz: 48 is less than 8000: give hertz, e.g. 48000",
        ),
        ("gap_s: 0.4", "gap_s: 400", "signal.gap_s: 400 is more than 10: give seconds, e.g. 0.4 for 400 ms"),
        (
            "[-0.045, -0.045,",
            "[-45, -0.045,",
            "board.buzzers[0].position_m[0]: -45 is less than -2: give metres, e.g. -0.045",
        ),
        (
            "square_size_m: 0.025",
            "square_size_m: -0.025",
            "board.square_size_m: -0.025 is not more than 0: give metres",
        ),
        (
            "square_size_m: 0.025",
            "square_size_m: 25 mm",
            "board.square_size_m: '25 mm' is not a number: give a plain number",
        ),
        ("square_size_m: 0.025", "square_size_m: .nan", "board.square_size_m: nan is not a finite number"),
        ("square_size_m: 0.025", "square_size_m:", "board.square_size_m: nothing is not a number"),
        ("  square_size_m: 0.025", "  #", "board.square_size_m: missing: add 'square_size_m: ...' (in metres; side of"),
        ("start_hz: 1000", "start_hz: 1", "signal.start_hz: 1 is less than 50: give hertz"),
        ("kind: sweep", "kind: chirp", "signal.kind: 'chirp' is not known: give one of sweep, mls, tone"),
        ("  kind: sweep", "  #", "signal.kind: missing: give one of sweep, mls, tone"),
        ("stop_hz: 8000", "stop_hz: 30000", "the signal reaches 30000 Hz, more than half of audio.sample_rate_hz"),
        ("6, 7, 8]", "6, 7, 7]", "audio: channel 7 is listed twice"),
        ("6, 7, 8]", "6, 7, 7.5]", "audio.channels[7]: 7.5 is not a whole number"),
        ("[1, 2, 3, 4, 5, 6, 7, 8]", "[1, 2]", "audio.channels: 2 entries: give at least 4"),
        ("[1, 2, 3, 4, 5, 6, 7, 8]", "8", "audio.channels: 8 is not a list"),
        (
            "  # reference_microphone: {channel: 10",
            "  reference_microphone: {channel: 8",
            "audio: channel 8 is listed twice",
        ),
        ("    name: USB", "    # USB", "audio.device.name: missing"),
        ("intrinsics: from session", "intrinsics: auto", "camera.intrinsics: 'auto' is not known: give 'from session'"),
        (
            "intrinsics: from session",
            "intrinsics: {focal_px: [900, -900], principal_px: [640, 360]}",
            "camera.intrinsics.focal_px: focal lengths must be greater than 0 pixels",
        ),
        ("  source: 0", "  #", "camera: driver opencv needs a source: add 'source: 0'"),
        ("id: 2", "id: 1", "board: buzzer 1 is listed twice"),
        ("corners: [9, 6]", "corners: [9, 7]", "board: a checkerboard of 9 x 7 corners looks the same upside down"),
        ("pattern: checkerboard", "pattern: charuco", "board: pattern charuco and the key charuco go together"),
        ("driver: serial", "driver: usb", "trigger.driver: 'usb' is not known: give 'simulated' or 'serial'"),
        ("port: auto", "port: somewhere", "trigger.port: port 'somewhere' is not 'auto', a path, or USB ids"),
        ("name: bench8", "name: 8", "name: 8 is not text: put it in quotes"),
        ("name: bench8", "name: ''", "name: '' is not possible: string should have at least 1 character"),
        ("locked: true", "locked: 3", "camera.exposure.locked: 3 is neither true nor false"),
        ("temperature_c: 20", "speed_of_sound_std_m_s: 1", "medium: give either temperature_c or speed_of_sound_m_s"),
        ("low_m: [0.0", "low_m: [0.6", "calibration.start_box_m: low_m must be below high_m on every axis"),
        ("audio:", "audio: 3\nboard2:", "audio: 3 stands where keys should: give channels, device, driver"),
    ],
)
def test_a_mistake_gets_one_clear_line_with_file_key_and_remedy(old, new, line):
    assert any(said.startswith(f"rig.yaml: {line}") for said in complaint(changed(old, new)).splitlines())


@pytest.mark.parametrize("new", ["square_size_mm: 25", "square_size_m: 25", "square_size_m: -0.025"])
def test_one_slip_is_one_line(new):
    assert len(complaint(changed("square_size_m: 0.025", new)).splitlines()) == 1


def test_several_mistakes_are_all_named():
    text = changed("square_size_m: 0.025", "square_size_m: 25").replace("poses: 25", "poses: 0")
    assert [line.split(":")[1].strip() for line in complaint(text).splitlines()] == [
        "board.square_size_m",
        "capture.poses",
    ]


def test_a_flood_of_mistakes_is_cut_short():
    said = complaint(changed("[1, 2, 3, 4, 5, 6, 7, 8]", "[a, b, c, d, e, f, g, h, i, j]")).splitlines()
    assert len(said) == 9
    assert said[-1] == "rig.yaml: and 2 more problems"


def test_a_charuco_board_needs_a_dictionary_of_opencv():
    board = "pattern: charuco\n  charuco: {dictionary: %s, marker_size_m: 0.018}"
    good = parse_description(changed("pattern: checkerboard", board % "DICT_5X5_100"), "rig.yaml")
    assert good.board.charuco is not None
    assert "no dictionary 'DICT_5X5_1'" in complaint(changed("pattern: checkerboard", board % "DICT_5X5_1"))
    too_big = changed("pattern: checkerboard", board % "DICT_5X5_100").replace("0.018", "0.025")
    assert "marker_size_m must be smaller than square_size_m" in complaint(too_big)


def test_the_branch_of_the_intrinsics_is_chosen_by_what_stands_there():
    given = parse_description(
        changed("intrinsics: from session", "intrinsics: {focal_px: [900, 910], principal_px: [640, 360]}"), "rig.yaml"
    )
    assert given.camera.intrinsics == Intrinsics(focal_px=(900, 910), principal_px=(640, 360))
    assert parse_description(TEMPLATE, "rig.yaml").camera.intrinsics == "from session"


def test_the_reference_microphone_is_recorded_last():
    text = changed("  # reference_microphone: {channel: 10", "  reference_microphone: {channel: 10")
    assert parse_description(text, "rig.yaml").audio.recorded_channels() == (1, 2, 3, 4, 5, 6, 7, 8, 10)


def test_the_speed_of_sound_comes_from_the_temperature_or_as_given():
    warm = parse_description(TEMPLATE, "rig.yaml").medium
    assert math.isclose(warm.speed_m_s(), 343.2, abs_tol=0.05)
    assert math.isclose(warm.speed_std_m_s(), 0.6, abs_tol=0.01)
    assert parse_description(shipped_rigs()["kinect8"], "kinect8").medium.speed_m_s() == 340


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "rig.yaml: not a rig description"),
        ("- 1\n- 2", "rig.yaml: not a rig description"),
        ("name: a\nname: b", "rig.yaml, line 2, column 1: key 'name' is given twice: keep one"),
        ("audio: {driver: a, driver: b}", "rig.yaml, line 1, column 20: key 'driver' is given twice"),
        ("a: b: c", "rig.yaml, line 1, column 5: mapping values are not allowed here"),
        ("audio:\n\tdriver: x", "rig.yaml, line 2, column 1: a tab: indent with spaces"),
        ("a: &x [1]\nb: *x", "rig.yaml, line 2, column 4: aliases (*name) are not known here: write the value"),
        ("!!python/object/apply:os.getcwd []", "rig.yaml, line 1, column 1: could not determine a constructor"),
        ("{[1]: 2}", "rig.yaml, line 1, column 2: found unhashable key"),
        ("when: 2001-99-99", "rig.yaml: not YAML: month must be in 1..12"),
        ("\x00", "rig.yaml: not YAML: unacceptable character"),
        ("[" * 5000, "rig.yaml: not YAML"),
        ("a: " + "9" * 5000, "rig.yaml: not YAML"),
        ("1: 2", "rig.yaml: 1: unknown key"),
    ],
)
def test_text_that_is_no_description_is_refused_with_its_place(text, said):
    assert complaint(text).startswith(said)


def test_each_kind_of_signal_says_what_the_buzzer_plays():
    sweep_keys = TEMPLATE[TEMPLATE.index("  kind: sweep") : TEMPLATE.index("  gap_s: 0.4")]
    mls = parse_description(changed(sweep_keys, "  kind: mls\n  order: 10\n"), "rig.yaml").signal.waveform()
    assert (mls.kind, mls.order, mls.band_hz()) == ("mls", 10, (0.0, 8000.0))
    assert math.isclose(mls.duration_s, 1023 / 16000)
    tone = parse_description(changed(sweep_keys, "  kind: tone\n"), "rig.yaml").signal.waveform()
    assert (tone.kind, tone.band_hz()) == ("tone", (4000.0, 4000.0))
    too_long = changed(sweep_keys, "  kind: mls\n  order: 13\n  chip_rate_hz: 8000\n")
    assert complaint(too_long).startswith("rig.yaml: signal: this sequence lasts 1.02 s, the board's limit is 0.5 s")
