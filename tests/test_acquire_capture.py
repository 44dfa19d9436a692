"""A whole capture with the simulated rig: what is in the file, and what each fault does to it."""

import re
from pathlib import Path

import numpy as np
import pytest
from capturing import captured, small_rig, with_fault

from acquire import errors
from acquire.status import State
from rigs.errors import TargetError, TargetExistsError
from rigs.session.layout import FLAG_OVERFLOW
from rigs.session.reader import Session

DIAGRAM = Path(__file__).parents[1] / "docs" / "capture.md"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    path = tmp_path_factory.mktemp("good") / "s1.h5"
    listener = captured(path, seed=3)
    with Session.open(path) as session:
        yield session, listener


def lines(session):
    return [text.decode() for text in session.log["text"]]


def test_a_good_capture_is_complete_and_undamaged(good):
    session, listener = good
    assert session.complete
    assert session.verify() == []
    assert session.name == "s1"
    assert {"acoustic-camera-rig", "trigger", "audio", "camera"} <= session.versions.keys()
    assert listener.status.state is State.FINISHED
    assert not listener.warnings()
    assert lines(session) == [message.text for message in listener.messages]


def test_every_buzzer_is_fired_once_in_turn_in_every_pose(good):
    session, _ = good
    assert session.emissions[["pose", "buzzer", "accepted"]].tolist() == [(0, 1, 1), (0, 7, 1), (1, 1, 1), (1, 7, 1)]
    assert session.poses[["pose", "accepted"]].tolist() == [(0, 1), (1, 1)]


def test_a_pose_has_a_frame_at_its_start_one_at_its_end_and_some_between(good):
    session, _ = good
    for pose in session.poses:
        times_s = session.frames["host_time_s"][session.frames["pose"] == pose["pose"]]
        assert len(times_s) >= 4
        assert times_s[0] == pose["start_host_time_s"]
        last_emission_s = session.emissions["host_time_s"][session.emissions["pose"] == pose["pose"]].max()
        assert last_emission_s < times_s[-1] <= pose["end_host_time_s"] + 0.01


def test_audio_is_recorded_without_a_break(good):
    session, _ = good
    first, n = session.audio_blocks["first_sample"], session.audio_blocks["n_samples"]
    assert (first[1:] == (first + n)[:-1]).all()
    assert first[-1] + n[-1] == session.n_samples
    assert session.emissions["expected_sample"].max() < session.n_samples


def true_onset(session, emission, rise=0.1):
    """Return the row where the nearest microphone hears an emission, less the way of the sound; there is no echo."""
    buzzer = [each.id for each in session.description.board.buzzers].index(emission["buzzer"])
    pose = session.truth.board_to_camera[emission["pose"]]
    source_m = pose[:3, :3] @ session.truth.buzzers_m[buzzer] + pose[:3, 3]
    distances_m = np.linalg.norm(session.truth.microphones_m - source_m, axis=1)
    nearest = int(distances_m.argmin())
    begin = int(emission["expected_sample"]) - 2400
    sound = np.abs(session.audio(begin, 4800)[:, nearest])
    travel_samples = distances_m[nearest] / session.truth.speed_of_sound_m_s * session.sample_rate_hz
    return begin + int(np.argmax(sound > rise * sound.max())) - travel_samples


def test_the_expected_sample_is_within_milliseconds_of_the_true_onset(good):
    session, _ = good
    late_s = [
        (emission["expected_sample"] - true_onset(session, emission)) / session.sample_rate_hz
        for emission in session.emissions
    ]
    assert np.abs(late_s).max() < 0.005


def test_the_states_of_the_diagram_are_those_of_the_code():
    diagram = re.search(r"```mermaid\n(.*?)```", DIAGRAM.read_text(encoding="utf-8"), re.DOTALL).group(1)
    named = set(re.findall(r"^ *state \"([a-z ]+)\" as ", diagram, re.MULTILINE))
    assert named == {state.value for state in State}


def test_a_capture_goes_through_its_states_in_order(good):
    _, listener = good
    order = [state for state in listener.states if state != State.OPENING.value]
    assert order[:3] == ["waiting", "settling", "firing"]
    assert "comparing" in order


def test_repeats_fire_every_buzzer_again(tmp_path):
    captured(tmp_path / "s.h5", small_rig(signal={"repeats": 2}), poses=1)
    with Session.open(tmp_path / "s.h5") as session:
        assert session.emissions[["buzzer", "repeat"]].tolist() == [(1, 0), (7, 0), (1, 1), (7, 1)]


def test_the_same_seed_gives_the_same_recording(tmp_path):
    for name in ("a.h5", "b.h5"):
        captured(tmp_path / name, poses=1, seed=5)
    with Session.open(tmp_path / "a.h5") as a, Session.open(tmp_path / "b.h5") as b:
        np.testing.assert_array_equal(a.audio(0, a.n_samples), b.audio(0, b.n_samples))


def test_a_dead_channel_is_named_and_the_session_goes_on(tmp_path):
    listener = captured(tmp_path / "s.h5", with_fault("dead_channel", channel=3, pose=1))
    assert "channel 3 is silent in every emission: check its cable" in listener.warnings()
    assert listener.status.faults == {3: "silent"}
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete
        assert session.poses["accepted"].tolist() == [1, 1]
        # tried once more, then known to be the channel's own fault
        assert session.emissions["accepted"].tolist() == [1, 1, 0, 1, 1]


def test_a_loud_channel_is_named_and_the_session_goes_on(tmp_path):
    listener = captured(tmp_path / "s.h5", with_fault("loud_channel", channel=5), poses=1)
    assert "channel 5 is clipped in every emission: turn its gain down" in listener.warnings()


def test_a_silent_buzzer_is_fired_again_and_stored_as_not_accepted(tmp_path):
    listener = captured(tmp_path / "s.h5", with_fault("silent_buzzer", buzzer=7), poses=1)
    assert "buzzer 7: not heard, 3 times: check its cable and plug" in listener.warnings()
    assert (listener.status.fired[7], listener.status.missed) == (2, {1: 0, 7: 2})
    with Session.open(tmp_path / "s.h5") as session:
        assert session.emissions[["buzzer", "accepted"]].tolist() == 2 * [(1, 1), (7, 0), (7, 0), (7, 0)]
        assert session.poses["accepted"].tolist() == [0, 1]  # one emission does not confirm the latency


def test_an_overflow_is_flagged_logged_and_its_emission_fired_again(tmp_path):
    listener = captured(tmp_path / "s.h5", with_fault("audio_overflow", pose=1))
    assert listener.warnings().count("of the recording: the sound device says so") == 1
    with Session.open(tmp_path / "s.h5") as session:
        assert np.count_nonzero(session.audio_blocks["flags"] & FLAG_OVERFLOW) == 1
        assert session.emissions["expected_sample"][session.emissions["accepted"] == 0].tolist() == [-1]
        accepted = session.emissions[session.emissions["accepted"] == 1]
        assert accepted[["pose", "buzzer"]].tolist() == [(0, 1), (0, 7), (1, 1), (1, 7)]
        late = [emission["expected_sample"] - true_onset(session, emission) for emission in accepted]
        assert np.abs(late).max() / session.sample_rate_hz < 0.005


def test_a_board_that_moves_is_measured_again_in_the_same_place(tmp_path):
    listener = captured(tmp_path / "s.h5", with_fault("board_moves", pose=1))
    assert re.search(r"the board moved by [0-9.]+ px while the buzzers sounded", listener.warnings())
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses[["pose", "accepted"]].tolist() == [(0, 1), (1, 0), (2, 1)]
        assert set(session.frames["pose"]) == {0, 1, 2}


@pytest.mark.parametrize("kind", ["trigger_lost", "audio_lost", "camera_lost"])
def test_a_lost_device_leaves_a_good_file_and_one_line(tmp_path, kind):
    path = tmp_path / "s.h5"
    with pytest.raises(errors.DeviceError) as caught:
        captured(path, with_fault(kind, pose=1))
    assert caught.value.exit_code == 3
    assert f"; 1 pose saved in {path}" in str(caught.value)
    assert "\n" not in str(caught.value)
    with Session.open(path) as session:
        assert session.complete
        assert session.verify() == []
        assert np.count_nonzero(session.poses["accepted"]) == 1
        assert session.log["level"][-1] == b"error"


def test_a_device_lost_at_once_leaves_an_empty_session(tmp_path):
    with pytest.raises(errors.DeviceError, match="0 poses saved"):
        captured(tmp_path / "s.h5", with_fault("camera_lost"))
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete
        assert len(session.poses) == 0


def test_a_board_that_stays_where_it_is_ends_the_wait(tmp_path):
    found = small_rig(capture={"new_pose_px": 1000, "pose_timeout_s": 6})
    with pytest.raises(
        errors.CaptureQualityError, match="where it was before: move the board to a place where it has not been; 1"
    ):
        captured(tmp_path / "s.h5", found)
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete


def test_a_board_that_is_never_found_ends_the_wait(tmp_path):
    found = small_rig(capture={"pose_timeout_s": 0.2})
    with pytest.raises(errors.CaptureQualityError, match=r"pose 1 of 2: after 0.2 s the board is not found: bring"):
        captured(tmp_path / "s.h5", found)


def test_a_picture_too_noisy_for_the_limit_says_which_limit(tmp_path):
    found = small_rig(capture={"still_px": 0.001, "pose_timeout_s": 3})
    with pytest.raises(
        errors.CaptureQualityError, match=r"board is moving \(moved by [0-9.]+ px\): .* raise capture.still_px"
    ):
        captured(tmp_path / "s.h5", found)


def test_a_picture_that_stays_blurred_says_what_helps(tmp_path):
    found = small_rig(capture={"max_blur_px": 0.5, "pose_timeout_s": 3})
    with pytest.raises(
        errors.CaptureQualityError,
        match=r"board is blurred \(blur 0\.\d+ px\): focus the camera .* raise capture.max_blur_px",
    ):
        captured(tmp_path / "s.h5", found)


@pytest.mark.parametrize("kind", ["tone", "mls"])
def test_other_signals_are_heard_in_a_room_that_rings(tmp_path, kind):
    found = small_rig(signal={"kind": kind, "gap_s": 0.4}, simulation={"rt60_s": 0.5})
    assert not captured(tmp_path / "s.h5", found).warnings()


def test_silence_in_pose_after_pose_ends_the_session(tmp_path):
    faults = [{"kind": "silent_buzzer", "buzzer": 1}, {"kind": "silent_buzzer", "buzzer": 7}]
    found = small_rig(simulation={"faults": faults}, capture={"retries": 0})
    with pytest.raises(errors.CaptureQualityError, match=r"no emission was good.*0 poses saved"):
        captured(tmp_path / "s.h5", found)
    with Session.open(tmp_path / "s.h5") as session:
        assert session.poses["accepted"].tolist() == [0, 0, 0]


def test_an_existing_file_is_refused_before_anything_is_touched(tmp_path):
    (tmp_path / "s.h5").write_text("precious")
    with pytest.raises(TargetExistsError):
        captured(tmp_path / "s.h5", with_fault("dead_channel", channel=99))
    assert (tmp_path / "s.h5").read_text() == "precious"


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(TargetError, match="no folder"):
        captured(tmp_path / "nowhere" / "s.h5")


def test_a_wish_to_stop_ends_within_a_pose_and_is_saved(tmp_path):
    asked = iter([False] * 40)
    with pytest.raises(errors.InterruptedCaptureError) as caught:
        captured(tmp_path / "s.h5", poses=50, stop_wanted=lambda: next(asked, True))
    assert caught.value.exit_code == 130
    with Session.open(tmp_path / "s.h5") as session:
        assert session.complete
        assert session.verify() == []
        assert f"{np.count_nonzero(session.poses['accepted'])} pose" in str(caught.value)
