"""A whole session without hardware: real firmware, PortAudio, OpenCV and pyserial, and the truth beside it.

It takes real time, so one session is captured and everything about it is checked.
"""

import numpy as np
from virtual_bench.session import (
    captured_and_calibrated,
    corner_errors_px,
    onset_offsets_s,
    place_at,
    spread_p95_s,
)  # fmt: skip

from rigs.session.layout import FLAG_OVERFLOW
from rigs.session.reader import Session

POSES = 20


def test_a_session_of_real_stacks_is_right_to_a_millimetre(tmp_path):
    outcome = captured_and_calibrated(tmp_path, POSES)
    with Session.open(outcome.session_path) as session:
        offsets_s = onset_offsets_s(session)
        corners_px = corner_errors_px(session, outcome.truth)
        say_figures(outcome.evaluation.rmse_m, offsets_s, corners_px)
        check_recording(session)
        check_against_truth(session, outcome.truth)
    check_the_check(outcome.check)
    assert f"{POSES} poses saved" in outcome.said
    assert outcome.evaluation.rmse_m <= 0.001
    assert len(offsets_s) > 2 * POSES  # those of which capture knew beforehand when they should be heard
    assert spread_p95_s(offsets_s) < 0.005
    assert corners_px.max() < 0.15


def say_figures(rmse_m, offsets_s, corners_px):
    print(  # noqa: T201
        f"virtual bench, {POSES} poses, {len(offsets_s)} emissions: microphones {1e3 * rmse_m:.2f} mm RMSE; onsets "
        f"{1e3 * np.median(offsets_s):.1f} ms after ON, 95 % within {1e3 * spread_p95_s(offsets_s):.1f} ms of that; "
        f"corners {np.median(corners_px):.3f} px"
    )


def check_the_check(check):
    """The check-up found every device, and heard every buzzer on every channel."""
    assert [row for row in check["rows"] if row["state"] == "bad"] == []
    assert np.isfinite(np.array(check["hearing"]["snr_db"], float)).all()
    assert check["hearing"]["buzzers"] == [1, 2, 3, 4, 5, 6]


def check_recording(session):
    assert session.complete
    assert session.verify() == []
    assert session.truth is None  # the bench keeps it to itself
    assert not (session.audio_blocks["flags"] & FLAG_OVERFLOW).any()
    assert set(session.emissions["buzzer"]) == {1, 2, 3, 4, 5, 6}
    assert session.emissions["accepted"].sum() > 5 * POSES
    assert "buzzer-board" in session.versions["trigger"]
    assert "opencv" in session.versions["camera"]
    assert "portaudio" in session.versions["audio"].lower()


def check_against_truth(session, truth):
    """Every emission that was stored was sounded, in this order, and those that count from the place of their pose."""
    sounded = truth.emissions
    assert [emission.buzzer for emission in sounded] == session.emissions["buzzer"].tolist()
    on_s = np.array([emission.on_s for emission in sounded])
    assert np.median(np.abs(session.emissions["host_time_s"] - on_s)) < 0.005
    for pose in session.poses[session.poses["accepted"] == 1]:
        rows = np.flatnonzero((session.emissions["pose"] == pose["pose"]) & (session.emissions["accepted"] == 1))
        assert {sounded[row].place for row in rows} == {place_at(truth, pose["start_host_time_s"])["number"]}
