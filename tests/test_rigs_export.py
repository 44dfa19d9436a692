"""`rig-session audio` and `rig-session frames`: sound and pictures out of a session."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import soundfile
from audio_inputs import pulse_source
from example_sessions import BLOCK, BUZZER, N_CHANNELS, RIG, add_pose, measured, new_session, picture, samples
from scipy.signal import correlate

from rigs.cli import cli
from rigs.command import run
from rigs.session.reader import Session

RATE_HZ = RIG.audio.sample_rate_hz


@pytest.fixture
def session(tmp_path) -> Path:
    """Return a session of two poses whose sound goes on for half a second."""
    path = tmp_path / "s1.h5"
    with new_session(path) as writer:
        add_pose(writer, 0)
        add_pose(writer, 1)
        for seed in range(50):
            writer.append_audio(samples(100 + seed), host_time_s=1.0, adc_time_s=0.0)
    return path


def rig_session(*arguments: object) -> int:
    return run("rig-session", cli, [str(argument) for argument in arguments])


def refused(capsys, *arguments: object) -> tuple[int, str]:
    """Run, and return the exit code and the one line that was said."""
    exit_code = rig_session(*arguments)
    error = capsys.readouterr().err.strip()
    assert error.startswith("rig-session: ")
    assert "\n" not in error
    return exit_code, error


def expected(path: Path, emission: int, before_s: float, after_s: float) -> np.ndarray:
    with Session.open(path) as session:
        begins = int(session.emissions["expected_sample"][emission])
        first = max(0, begins - round(before_s * RATE_HZ))
        end = begins + round((RIG.signal.waveform().duration_s + after_s) * RATE_HZ)
        return session.audio(first, end - first)


def test_an_emission_becomes_a_wav_file_sample_for_sample(session, capsys):
    before = session.read_bytes()
    assert rig_session("audio", session, "--emission", 2) == 0
    path = session.with_name("s1.emission-2.wav")
    assert f"{path}: emission 2" in capsys.readouterr().out
    sound, rate_hz = soundfile.read(path, dtype="float32")
    assert rate_hz == RATE_HZ
    np.testing.assert_array_equal(sound, expected(session, 2, 0.02, 0.2))
    assert session.read_bytes() == before


def test_channel_and_length_can_be_chosen(session, tmp_path):
    out = tmp_path / "one.wav"
    assert (
        rig_session("audio", session, "--emission", 3, "--channel", 4, "--before-s", 0, "--after-s", 0.01, "-o", out)
        == 0
    )
    sound, _ = soundfile.read(out, dtype="float32")
    np.testing.assert_array_equal(sound, expected(session, 3, 0.0, 0.01)[:, RIG.audio.channels.index(4)])


def test_flac_holds_24_bits(session, tmp_path):
    out = tmp_path / "one.flac"
    assert rig_session("audio", session, "--emission", 0, "-o", out) == 0
    assert soundfile.info(out).subtype == "PCM_24"
    sound, _ = soundfile.read(out, dtype="float32")
    np.testing.assert_allclose(sound, np.clip(expected(session, 0, 0.02, 0.2), -1, 1), atol=2.0**-23)


def test_a_range_becomes_a_folder(session):
    assert rig_session("audio", session, "--emission", "0-1,3", "--format", "flac") == 0
    names = sorted(path.name for path in session.with_name("s1.audio").iterdir())
    assert names == [
        f"emission-000{emission}-pose-{pose:03d}-buzzer-{BUZZER}.flac" for emission, pose in ((0, 0), (1, 0), (3, 1))
    ]


def test_all_emissions(session, tmp_path):
    assert rig_session("audio", session, "--all", "-o", tmp_path / "all") == 0
    assert len(list((tmp_path / "all").glob("*.wav"))) == 4


def test_all_emissions_leave_out_those_during_which_audio_was_lost(tmp_path, capsys):
    path = tmp_path / "s1.h5"
    with new_session(path) as writer:
        add_pose(writer, 0)
        writer.append_emission(
            pose=0, buzzer=BUZZER, repeat=0, waveform="sweep", board_time_s=1.0, host_time_s=1.0,
            expected_sample=-1, accepted=False,
        )  # fmt: skip
    assert rig_session("audio", path, "--all") == 0
    assert sorted(each.name[:13] for each in (tmp_path / "s1.audio").iterdir()) == ["emission-0000", "emission-0001"]
    assert "1 of 3 left out" in capsys.readouterr().out
    assert refused(capsys, "audio", path, "--emission", 2)[0] == 5


@pytest.mark.parametrize(
    ("arguments", "exit_code", "words"),
    [
        (("--emission", 9), 5, "there is no emission 9: they go from 0 to 3"),
        (("--emission", 1, "--channel", 77), 5, "channel 77 was not recorded: there are 1, 2"),
        (("--emission", 1, "-o", "x.mp3"), 2, "end the name with one of them"),
        (("--emission", 1, "-o", "x.flac", "--format", "wav"), 2, "x.flac: a name for FLAC, but --format wav"),
        (("--emission", 1, "-o", "s1.h5/x.wav"), 2, "s1.h5 is a file, not a folder"),
        (("--emission", 1, "-o", "nowhere/x.wav"), 2, "no folder"),
        (("--emission", "0-3", "-o", "nowhere/x"), 2, "no folder"),
        (("--emission", "0-3", "-o", "x.wav"), 2, "4 emissions make a file each: name a folder"),
        (("--emission", 1, "-o", "/sys/x.wav"), 2, "/sys/x.wav: cannot be made"),
        (("--emission", "0-3", "-o", "/sys/x"), 2, "/sys/x: cannot be made"),
    ],
)
def test_what_cannot_be_cut_is_refused(session, capsys, monkeypatch, arguments, exit_code, words):
    monkeypatch.chdir(session.parent)
    code, error = refused(capsys, "audio", session, *arguments)
    assert code == exit_code
    assert words in error
    assert [path.name for path in session.parent.iterdir()] == ["s1.h5"]


@pytest.mark.parametrize("arguments", [(), ("--all", "--emission", "1"), ("--emission", "3-1"), ("--emission", "one")])
def test_wrong_usage(session, capsys, arguments):
    assert rig_session("audio", session, *arguments) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_nothing_is_written_over(session, tmp_path, capsys):
    (tmp_path / "a.wav").write_text("mine")
    assert refused(capsys, "audio", session, "--emission", 1, "-o", tmp_path / "a.wav")[0] == 2
    (tmp_path / "s1.audio").mkdir()
    assert refused(capsys, "audio", session, "--all")[0] == 2
    (tmp_path / "s1.frames").mkdir()
    assert refused(capsys, "frames", session)[0] == 2
    assert (tmp_path / "a.wav").read_text() == "mine"


def test_sound_that_was_cut_off_or_never_recorded_is_told(tmp_path, capsys):
    short = tmp_path / "short.h5"
    with new_session(short) as writer:
        add_pose(writer, 0)
    assert rig_session("audio", short, "--emission", 0) == 0  # as far as it goes
    assert soundfile.info(tmp_path / "short.emission-0.wav").frames == 2 * BLOCK
    capsys.readouterr()
    silent = tmp_path / "silent.h5"
    with new_session(silent, **measured(1, 1)) as writer:
        writer.append_emission(
            pose=0, buzzer=BUZZER, repeat=0, waveform="sweep", board_time_s=np.nan, host_time_s=np.nan,
            expected_sample=-1, accepted=True,
        )  # fmt: skip
        writer.append_pose(pose=0, start_host_time_s=0.0, end_host_time_s=1.0, accepted=True)
    code, error = refused(capsys, "audio", silent, "--emission", 0)
    assert code == 5
    assert "no sound" in error


def test_flac_of_many_channels_is_refused(session, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("rigs.session.sound_files.MOST_FLAC_CHANNELS", N_CHANNELS - 1)
    code, error = refused(capsys, "audio", session, "--emission", 0, "-o", tmp_path / "a.flac")
    assert code == 2
    assert "choose some with --channel" in error
    assert [path.name for path in tmp_path.iterdir()] == ["s1.h5"]


def test_frames_come_out_as_the_camera_gave_them(session, capsys):
    assert rig_session("frames", session) == 0
    folder = session.with_name("s1.frames")
    assert "4 frames" in capsys.readouterr().out
    names = ["frame-00000-pose-000.png", "frame-00001-pose-000.png", "frame-00002-pose-001.png"]
    assert sorted(path.name for path in folder.iterdir())[:3] == names
    for number, shape in enumerate(((48, 64), (48, 64, 3))):
        found = cv2.imread(str(folder / names[number]), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(found, picture(number, shape))


def test_frames_of_a_pose(session, tmp_path, capsys):
    assert rig_session("frames", session, "--pose", 1, "-o", tmp_path / "f") == 0
    assert {path.name[-7:-4] for path in (tmp_path / "f").iterdir()} == {"001"}
    capsys.readouterr()
    code, error = refused(capsys, "frames", session, "--pose", 7)
    assert code == 5
    assert "there is no pose 7 with a picture: they go from 0 to 1" in error
    assert not (tmp_path / "s1.frames").exists()
    (tmp_path / "s1.frames").mkdir()
    code, error = refused(capsys, "frames", session, "--frame", 12)
    assert code == 5
    assert "there is no frame 12 with a picture: they go from 0 to 3" in error
    assert rig_session("frames", session, "--frame", 1, "-o", tmp_path / "one") == 0
    assert "one: 1 frame\n" in capsys.readouterr().out


def test_sound_that_the_session_does_not_hold_is_told(session, tmp_path, capsys):
    assert rig_session("audio", session, "--emission", 0, "--before-s", 60) == 0
    said = capsys.readouterr().out
    assert "shorter than asked for" in said
    assert rig_session("audio", session, "--emission", 0, "--before-s", 0, "-o", tmp_path / "a.wav") == 0
    assert "shorter" not in capsys.readouterr().out


def test_a_full_disk_is_named(session, tmp_path, capsys, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    code, error = refused(capsys, "frames", session, "-o", tmp_path / "f")
    assert code == 2
    assert f"{tmp_path / 'f'}: cannot be written (No space left on device): free some space" in error
    assert [path.name for path in tmp_path.iterdir()] == ["s1.h5"]


def test_a_damaged_frame_leaves_nothing_behind(session, capsys):
    with Session.open(session) as opened:
        piece = opened.png(2)[200:264].tobytes()
    content = session.read_bytes()
    assert content.count(piece) == 1
    session.write_bytes(content.replace(piece, bytes(64)))
    code, error = refused(capsys, "frames", session)
    assert code == 5
    assert "frame 2 is damaged" in error
    assert [path.name for path in session.parent.iterdir()] == ["s1.h5"]


def test_an_emission_is_played(session):
    """What the real PortAudio plays comes back from the sink, sample for sample but for when it begins."""
    played = expected(session, 1, 0.02, 0.2)[:, 0]
    with pulse_source() as (source, server):
        source.audio.open()
        program = "import sys; from rigs.cli import main; sys.argv[0] = 'rig-session'; main()"
        command = [sys.executable, "-c", program, "audio", str(session), "--emission", "1", "--play"]
        with subprocess.Popen(command, env=os.environ | server.environment, stdout=subprocess.PIPE) as player:
            blocks = []
            while player.poll() is None:
                blocks += source.record(0.2)
            blocks += source.record(1.0)
            assert player.returncode == 0
            assert b"emission 1, pose 0" in player.stdout.read()
        source.audio.close()
    heard = np.concatenate([block.samples for block in blocks])[:, 0]
    correlation = correlate(heard, played, "valid", method="fft")
    best = int(np.argmax(correlation))
    part = heard[best : best + len(played)]
    np.testing.assert_allclose(part, np.clip(played, -1, 1), atol=1e-4)


def test_a_player_without_a_device_is_told(session, tmp_path, capsys, monkeypatch):
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "sounddevice.py").write_text("raise OSError('PortAudio library not found')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "lib"))
    code, error = refused(capsys, "audio", session, "--emission", 1, "--play")
    assert code == 3
    assert "PortAudio library not found" in error


def test_sound_that_does_not_fit_on_the_disk_is_named(session, tmp_path, capsys, monkeypatch):
    def full(*_: object, **__: object) -> None:
        raise RuntimeError("System error.")

    monkeypatch.setattr("soundfile.write", full)
    code, error = refused(capsys, "audio", session, "--emission", 1, "-o", tmp_path / "a.wav")
    assert code == 2
    assert "a.wav: could not be written: free some space" in error
    assert not list(tmp_path.glob(".*"))
