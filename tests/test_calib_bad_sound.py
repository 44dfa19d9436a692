"""Everything that goes wrong with sound: each is named in the result, and none of it spoils the rest."""

import numpy as np
import pytest
from room_sound import RATE_HZ, RoomSound, Scenario, make_room_sound, wave_edges, write_room_session

from calib.emissions import EmissionTdoas, measure_tdoas
from calib.errors import NotEnoughDataError
from calib.flaws import Flaw
from rigs.description import RigDescription
from rigs.session.reader import Session
from rigs.waveform import Waveform

BAD = 13  # the emission that something happens to
N_PLAYED = round(0.1 * RATE_HZ)


@pytest.fixture(scope="module")
def good() -> RoomSound:
    return make_room_sound(Scenario(n_poses=5, seed=7, max_order=7))


@pytest.fixture
def measured(tmp_path):
    def measure(made: RoomSound, labels: list[str] | None = None, mode="auto") -> EmissionTdoas:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.h5"
        with Session.open(write_room_session(path, made, labels)) as session:
            return measure_tdoas(session, mode)

    return measure


def onset(made: RoomSound, row: int = BAD) -> int:
    return int(made.arrival_s[row].min() * RATE_HZ)


def errors_s(made: RoomSound, tdoas: EmissionTdoas) -> np.ndarray:
    first, second = (tdoas.pairs - 1).T
    return tdoas.tdoa_s - (made.arrival_s[:, second] - made.arrival_s[:, first])


def assert_the_rest_is_right(made: RoomSound, tdoas: EmissionTdoas, rows=(), channels=()) -> None:
    """All but some rows and channels must be there, and right to a microsecond."""
    rest = errors_s(made, tdoas)
    rest = np.delete(rest, list(rows), axis=0)
    rest = rest[:, ~np.isin(tdoas.pairs, channels).any(axis=1)]
    assert np.isfinite(rest).all()
    assert np.abs(rest).max() < 1e-6


def hit(tdoas: EmissionTdoas, flaw: Flaw) -> np.ndarray:
    assert tdoas.sound is not None
    return tdoas.sound.flaws.table.get(flaw, np.zeros(tdoas.sound.flaws.shape, dtype=bool))


def burst(n: int, low_hz: float, high_hz: float, seed: int) -> np.ndarray:
    """Noise in a band."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(n))
    frequency = np.fft.rfftfreq(n, 1 / RATE_HZ)
    spectrum[(frequency < low_hz) | (frequency > high_hz)] = 0
    noise = np.fft.irfft(spectrum, n)
    return noise / noise.std()


def test_good_sound_has_no_flaw(good, measured):
    tdoas = measured(good)
    assert tdoas.sound.flaws.counts() == {}
    assert tdoas.warnings == []
    assert_the_rest_is_right(good, tdoas)


def test_a_silent_emission(good, measured):
    sound = good.sound.copy()
    quiet = sound[:4800]
    begin = onset(good) - 2000
    sound[begin : begin + 20000] = np.resize(quiet, (20000, 8))
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.NOT_HEARD)[BAD].all()
    assert_the_rest_is_right(good, tdoas, rows=[BAD])


def test_silence_all_along(good, measured):
    noise = 1e-3 * np.random.default_rng(0).standard_normal(good.sound.shape)
    for sound in (noise, np.zeros_like(good.sound)):
        with pytest.raises(NotEnoughDataError, match="no emission was heard"):
            measured(good.with_sound(sound))


def test_clipping(good, measured):
    sound = good.sound.copy()
    sound[:, 2] = np.clip(sound[:, 2] * 0.99 / np.abs(sound[:, 2]).max() * 4, -1, 1)
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.CLIPPED)[:, 2].mean() > 0.5
    assert not np.delete(hit(tdoas, Flaw.CLIPPED), 2, axis=1).any()
    assert any("channel 3 clipped" in warning for warning in tdoas.warnings)
    assert_the_rest_is_right(good, tdoas, channels=[3])
    bad = errors_s(good, tdoas)[:, (tdoas.pairs == 3).any(axis=1)]
    assert np.nanmax(np.abs(bad)) < 20e-6


@pytest.mark.parametrize("level", [0.0, 1e-4], ids=["digital silence", "noise alone"])
def test_a_dead_channel(good, measured, level):
    sound = good.sound.copy()
    sound[:, 4] = level * np.random.default_rng(0).standard_normal(len(sound))
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.DEAD_CHANNEL)[:, 4].all()
    assert any("channel 5 heard none of the emissions (dead channel)" in warning for warning in tdoas.warnings)
    assert_the_rest_is_right(good, tdoas, channels=[5])


def test_a_duplicated_channel(good, measured):
    sound = good.sound.copy()
    sound[:, 6] = 0.7 * sound[:, 1]
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.COPIED_CHANNEL)[:, 6].all()
    assert np.isnan(tdoas.tdoa_s[:, (tdoas.pairs == 7).any(axis=1)]).all()
    assert any("channel 7" in warning and "duplicated" in warning for warning in tdoas.warnings)
    assert_the_rest_is_right(good, tdoas, channels=[7])


def test_inverted_polarity_is_named_and_harmless(good, measured):
    sound = good.sound.copy()
    sound[:, 3] *= -1
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.INVERTED)[:, 3].all()
    assert not np.delete(hit(tdoas, Flaw.INVERTED), 3, axis=1).any()
    assert any("channel 4: polarity inverted" in warning for warning in tdoas.warnings)
    assert_the_rest_is_right(good, tdoas)


def test_a_wrong_waveform_by_its_label(good, measured):
    labels = [good.description.signal.waveform().label()] * len(good.pose)
    labels[BAD] = "sweep 2000-3000 Hz 0.1 s"
    tdoas = measured(good, labels)
    assert hit(tdoas, Flaw.WRONG_WAVEFORM)[BAD].all()
    assert_the_rest_is_right(good, tdoas, rows=[BAD])


def test_a_wrong_waveform_by_its_sound(good, measured):
    """The sweep runs backwards."""
    sound, begin = good.sound.copy(), onset(good)
    sound[begin : begin + N_PLAYED + 800] = sound[begin : begin + N_PLAYED + 800][::-1]
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.WRONG_WAVEFORM)[BAD].all()
    assert_the_rest_is_right(good, tdoas, rows=[BAD])


def test_an_emission_cut_by_the_end_of_the_file(good, measured):
    last = len(good.pose) - 1
    tdoas = measured(good.with_sound(good.sound[: onset(good, last) + N_PLAYED // 2]))
    assert hit(tdoas, Flaw.CUT_OFF)[last].all()
    assert any("cut by end of file" in warning for warning in tdoas.warnings)
    assert_the_rest_is_right(good, tdoas, rows=[last])


@pytest.mark.parametrize("mains_hz", [50.0, 60.0])
def test_mains_hum_is_named_and_harmless(good, measured, mains_hz):
    sound, time_s = good.sound.copy(), np.arange(len(good.sound)) / RATE_HZ
    for harmonic, level in ((1, 0.1), (2, 0.03), (3, 0.05)):
        sound[:, 5] += level * np.sin(2 * np.pi * mains_hz * harmonic * time_s + harmonic)
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.HUM)[:, 5].all()
    assert not np.delete(hit(tdoas, Flaw.HUM), 5, axis=1).any()
    assert any("channel 6: hum" in warning for warning in tdoas.warnings)
    assert_the_rest_is_right(good, tdoas)


def test_a_door_slam_over_an_emission(good, measured):
    sound, begin = good.sound.copy(), onset(good)
    slam = 0.1 * burst(6000, 30, 6000, 1) * np.exp(-np.arange(6000) / 1500)
    for column in range(8):  # it comes from somewhere
        sound[begin + 900 + 7 * column :][:6000, column] += slam
    assert_disturbed_but_honest(good, measured(good.with_sound(sound)))


def test_a_voice_over_an_emission(good, measured):
    sound, begin, n = good.sound.copy(), onset(good) - 6000, 24000
    time_s = np.arange(n) / RATE_HZ
    voice = sum(np.sin(2 * np.pi * 140 * k * time_s + k) / (1 + (k / 8) ** 2) for k in range(1, 50))
    for column in range(8):
        sound[begin + 11 * column :][:n, column] += 0.02 * voice / voice.std()
    assert_disturbed_but_honest(good, measured(good.with_sound(sound)))


def test_noise_that_drowns_an_emission(good, measured):
    sound, begin = good.sound.copy(), onset(good)
    sound[begin - 4000 : begin + 8000] += 0.5 * np.random.default_rng(1).standard_normal((12000, 8))
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.DISTURBED)[BAD].all()
    assert not np.isfinite(tdoas.tdoa_s[BAD]).any()
    assert_the_rest_is_right(good, tdoas, rows=[BAD])


def assert_disturbed_but_honest(made: RoomSound, tdoas: EmissionTdoas) -> None:
    assert hit(tdoas, Flaw.DISTURBED)[BAD].mean() > 0.5 or np.isnan(tdoas.sound.arrival_s[BAD]).mean() > 0.5
    assert_the_rest_is_right(made, tdoas, rows=[BAD])
    first, second = (tdoas.pairs - 1).T
    std_s = np.hypot(tdoas.sound.std_s[:, first], tdoas.sound.std_s[:, second])
    deviations = np.abs(errors_s(made, tdoas)[BAD] / std_s[BAD])
    assert not (deviations > 5).any()
    assert np.nanmedian(std_s[BAD]) > 2 * np.median(std_s)


@pytest.mark.parametrize("lag_s", [0.001, 0.012, -0.008])
def test_two_buzzers_at_once(good, measured, lag_s):
    """Another buzzer of the same pose plays over it."""
    sound, other = good.sound.copy(), BAD + 2
    shift = onset(good) - onset(good, other) + round(lag_s * RATE_HZ)
    begin = onset(good, other) - 500
    sound[begin + shift : begin + shift + 12000] += good.sound[begin : begin + 12000]
    tdoas = measured(good.with_sound(sound))
    assert hit(tdoas, Flaw.TWO_SOURCES)[BAD].mean() > 0.5
    assert np.isnan(tdoas.tdoa_s[BAD]).all()
    assert_the_rest_is_right(good, tdoas, rows=[BAD])


def test_a_tone_burst_is_refused(good, measured):
    described = good.description.model_dump(mode="json", exclude_none=True)
    described["signal"] = {"kind": "tone", "frequency_hz": 4000.0, "gap_s": 0.3}
    tone = RoomSound(**{**good.__dict__, "description": RigDescription.model_validate(described)})
    for mode in ("auto", "matched", "gcc-phat"):
        with pytest.raises(NotEnoughDataError, match="ambiguous by whole periods"):
            measured(tone, mode=mode)


def test_a_buzzer_that_makes_a_tone_of_the_sweep_is_ambiguous(measured):
    """A piezo so resonant that nothing but its tone is heard: at low level a period cannot be told from the next."""
    ringing = make_room_sound(Scenario(n_poses=4, seed=3, rt60_s=0.0, snr_db=0.0, quality=100.0))
    tdoas = measured(ringing)
    wrong = np.abs(errors_s(ringing, tdoas)) > 20e-6
    assert wrong.sum() <= 0.005 * np.isfinite(tdoas.tdoa_s).sum()
    named = hit(tdoas, Flaw.AMBIGUOUS) | hit(tdoas, Flaw.NOT_HEARD) | hit(tdoas, Flaw.NO_CONSISTENT_PATH)
    assert hit(tdoas, Flaw.AMBIGUOUS).any()
    assert (named.any() | ~np.isfinite(tdoas.tdoa_s)).any()


def test_gcc_phat_needs_to_know_no_waveform(good, measured):
    labels = ["mls order 10 16000 Hz"] * len(good.pose)
    tdoas = measured(good, labels)  # auto: nothing that was played is what the description says
    assert tdoas.sound.mode == "gcc-phat"
    assert_the_rest_is_right(good, tdoas)
    with pytest.raises(NotEnoughDataError, match="gcc-phat"):
        measured(good.with_sound(good.sound), labels, mode="matched")


def test_edges_of_the_waveform_are_those_of_the_room(good):
    """Two writings of one law."""
    for waveform in (good.description.signal.waveform(), Waveform("mls", 1023 / 16000, 0.0, 8000.0, 10, 16000.0)):
        times_s, steps = waveform.edges()
        np.testing.assert_allclose(times_s, wave_edges(waveform)[0], atol=1e-12)
        np.testing.assert_array_equal(steps, wave_edges(waveform)[1])
