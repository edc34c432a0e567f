"""The noise fit against the Cramer-Rao figures, tones, and the articles' claim."""

import csv
import json
import math
import subprocess
import sys
import wave

import numpy as np
import pytest

from edge_daemon.config.settings import Sound
from edge_daemon.errors import BadInput
from edge_daemon.records import Bands, Burst, Status
from edge_daemon.sound.noise_estimator import NoiseEstimator
from edge_daemon.sound.noise_model import fit_noise, noise_json
from edge_daemon.sound.noise_steps import terms
from edge_daemon.sound.sound_file import fit_sound_file
from edge_daemon.sound.spectrum import Spectrum, SpectrumAverage

SEED = 7
F_HZ = np.linspace(10.0, 10_000.0, 999)
ONES = terms(F_HZ, 300.0) @ np.ones(5)
CRAMER_RAO_PERCENT = {1e4: (0.08, 1.4, 4.2, 3.5, 0.66), 100.0: (0.8, 13.5, 42.0, 35.0, 6.6)}


def waveform(a, rate_hz, seconds, rng):
    """Gaussian noise with the model's spectrum, shaped in the frequency domain; flat below 10 Hz."""
    n = int(rate_hz * seconds)
    f = np.maximum(np.fft.rfftfreq(n, 1 / rate_hz), 10.0)
    white = np.fft.rfft(rng.normal(size=n))
    return np.fft.irfft(white * np.sqrt(terms(f, 300.0) @ np.asarray(a) * rate_hz / 2), n)


@pytest.mark.parametrize("averages", [1e4, 100.0])
def test_error_and_stated_sd_meet_the_cramer_rao_bound(averages):
    rng = np.random.default_rng(SEED)
    fits = [
        fit_noise(Spectrum(F_HZ, ONES * rng.gamma(averages, 1 / averages, len(F_HZ)), averages)) for _ in range(250)
    ]
    errors = np.array([fit.value - 1 for fit in fits])
    sd = np.mean([fit.sd for fit in fits], axis=0)
    np.testing.assert_allclose(100 * sd, CRAMER_RAO_PERCENT[averages], rtol=0.05)
    assert np.all(np.sqrt((errors**2).mean(axis=0)) < 1.12 * sd), f"seed {SEED}"
    inside = np.mean(np.abs(errors) < 1.96 * np.array([fit.sd for fit in fits]))
    assert 0.93 < inside < 0.97


def test_articles_simulation_within_one_percent_in_ten_iterations():
    rng = np.random.default_rng(SEED)
    own_band = np.array([1.0, 3.0, 10.0, 3.0, 1.0])
    psd = terms(F_HZ, 300.0) @ own_band
    fit = fit_noise(Spectrum(F_HZ, psd * (1 + 1e-3 * rng.normal(size=len(psd))), 1e6))
    np.testing.assert_allclose(fit.value, own_band, rtol=0.01)
    assert fit.iterations <= 10


def test_coefficients_that_the_spectrum_does_not_carry_are_said_so():
    rng = np.random.default_rng(SEED)
    fits = [fit_noise(Spectrum(F_HZ, ONES * rng.gamma(10.0, 0.1, len(F_HZ)), 10.0)) for _ in range(30)]
    share = np.mean([fit.identified for fit in fits], axis=0)
    assert share[0] == 1.0 and share[4] > 0.9
    assert share[2] < 0.2 and share[3] < 0.2
    assert all(np.all(fit.psd(F_HZ) > 0) for fit in fits)
    # a1 has 1.4 % at 10^4 averages: a third of it takes so many; a0 needs no more than it has
    needed = fit_noise(Spectrum(F_HZ, ONES, 10.0)).averages_needed
    assert needed[1] == pytest.approx(1e4 * (0.014 * 3) ** 2, rel=0.15)
    assert needed[0] < 10


def test_tones_are_found_and_do_not_move_the_noise():
    rng = np.random.default_rng(SEED)
    psd = ONES * rng.gamma(200.0, 1 / 200.0, len(F_HZ))
    plain = fit_noise(Spectrum(F_HZ, psd, 200.0))
    psd[40] += 300 * ONES[40]
    psd[700] += 50 * ONES[700]
    fit = fit_noise(Spectrum(F_HZ, psd, 200.0))
    assert {round(tone.frequency_hz) for tone in fit.tones} == {round(F_HZ[40]), round(F_HZ[700])}
    assert np.all(np.abs(fit.value - plain.value) < 1.0 * plain.sd)


def test_welch_of_a_known_noise_and_a_known_tone():
    rng = np.random.default_rng(SEED)
    rate_hz, truth = 25_600.0, np.array([1e-8, 2e-8, 2e-8, 1e-8, 1e-9])
    sound = waveform(truth, rate_hz, 40.0, rng)
    t = np.arange(len(sound)) / rate_hz
    average = SpectrumAverage(10.0, 10_000.0, 1e9)
    for i in range(40):
        second = slice(i * 25_600, (i + 1) * 25_600)
        average.add_waveform(float(i), sound[second] + 0.01 * np.sin(2 * math.pi * 1000.0 * t[second]), rate_hz)
    fit = fit_noise(average.spectrum)
    assert np.all(np.abs(fit.value - truth)[:4] < 4 * fit.sd[:4])
    assert fit.tones[0].frequency_hz == pytest.approx(1000.0, abs=7)
    assert fit.tones[0].level == pytest.approx(0.01 / math.sqrt(2), rel=0.03)


def test_stated_sd_of_a_welch_spectrum_is_honest():
    rng = np.random.default_rng(SEED)
    truth, scores = np.array([1e-8, 2e-8, 2e-8, 1e-8, 1e-9]), []
    for _ in range(60):
        average = SpectrumAverage(50.0, 10_000.0, 1e9)
        average.add_waveform(0.0, waveform(truth, 25_600.0, 2.0, rng), 25_600.0)
        fit = fit_noise(average.spectrum)
        scores.append((fit.value - truth) / fit.sd)
    spread = np.std(scores, axis=0)
    assert np.all((spread > 0.6) & (spread < 1.35)), spread


def test_live_from_bursts_and_from_bands_agree_and_flaws_are_invalid():
    rng = np.random.default_rng(SEED)
    settings = Sound(source="mic", signal="sound")
    hearing, banded = NoiseEstimator(settings), NoiseEstimator(settings)
    for i in range(20):
        value = waveform(np.full(5, 1e-8), 25_600.0, 1.0, rng)
        rows = hearing.update(Burst("mic", "sound", float(i), 25_600.0, value), 100.0)
        psd = 1e-8 * ONES * rng.gamma(12.0, 1 / 12.0, len(F_HZ))
        other = banded.update(Bands("mic", "sound", float(i), F_HZ, psd, 12.0), math.nan)
    a0 = {row.name: row for row in rows}["noise_a0"]
    assert a0.status is Status.VALID
    assert abs(a0.value - 1e-8) < 4 * a0.sd
    assert abs(other[0].value - 1e-8) < 4 * other[0].sd
    bad = hearing.update(Burst("mic", "sound", 21.0, 25_600.0, np.full(25_600, math.nan)), 100.0)
    assert all(row.status is Status.INVALID and math.isnan(row.value) for row in bad)
    assert hearing.update(Burst("mic", "sound", 22.0, 25_600.0, value), 100.0)[0].status is Status.VALID


def write_csv(path, header, rows):
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    return path


def test_three_kinds_of_file(tmp_path):
    rng = np.random.default_rng(SEED)
    sound = waveform(np.full(5, 1e-11), 25_600.0, 8.0, rng)
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setparams((1, 3, 25_600, 0, "NONE", ""))
        counts = np.round(sound * 2**23).astype("<i4")
        file.writeframes(counts.view(np.uint8).reshape(-1, 4)[:, :3].tobytes())
    from_wav, unit, _ = fit_sound_file(tmp_path / "a.wav")
    t = np.arange(len(sound)) / 25_600.0
    from_csv, _, _ = fit_sound_file(write_csv(tmp_path / "a.csv", ("time_s", "sound"), zip(t, sound, strict=True)))
    np.testing.assert_allclose(from_wav.value, from_csv.value, rtol=1e-3)
    psd = ONES * rng.gamma(100.0, 0.01, len(F_HZ))
    rows = zip(F_HZ, psd, np.full(len(psd), 100.0), strict=True)
    given, _, _ = fit_sound_file(write_csv(tmp_path / "s.csv", ("frequency_hz", "psd", "averages"), rows))
    assert unit == "FS^2/Hz"
    assert given.averages == 100.0
    np.testing.assert_allclose(given.value, fit_noise(Spectrum(F_HZ, psd, 100.0)).value)


def test_json_has_the_contracts_keys():
    document = json.loads(json.dumps(noise_json(fit_noise(Spectrum(F_HZ, ONES, 100.0)), "Pa^2/Hz")))
    assert set(document) == {"reference_hz", "coefficients", "averages", "iterations", "tones", "unit"}
    assert [row["beta"] for row in document["coefficients"]] == [0, 1, 2, 3, 4]
    row = document["coefficients"][2]
    assert set(row) == {"beta", "value", "sd", "identified", "value_hz"}
    assert row["value_hz"] == pytest.approx(row["value"] * 300.0**2)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("absent.wav", None, "cannot read"),
        ("bad.wav", b"RIFF", "no sound file that can be read"),
        ("empty.csv", b"", "empty"),
        ("header.csv", b"a,b\n1,2\n", "header"),
        ("text.csv", b"time_s,sound\n0,1\n0.1,x\n", "line 3, sound"),
        ("fields.csv", b"time_s,sound\n0,1\n0.1\n", "line 3"),
        ("uneven.csv", b"time_s,sound\n0,1\n0.1,1\n0.2,1\n0.3,2\n0.4,1\n0.1,1\n", "line 7, time_s"),
        ("short.csv", b"time_s,sound\n0,1\n0.1,1\n", "too short"),
        ("few.csv", b"frequency_hz,psd,averages\n10,1,5\n20,1,5\n", "cannot be fitted"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, name, content, words):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadInput) as refused:
        fit_sound_file(path)
    assert words in str(refused.value) and str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_command(tmp_path):
    path = write_csv(
        tmp_path / "s.csv",
        ("frequency_hz", "psd", "averages"),
        zip(F_HZ, ONES, np.full(len(F_HZ), 100.0), strict=True),
    )
    run = subprocess.run(
        [sys.executable, "-m", "edge_daemon", "noise", str(path), "--json", "-"],
        capture_output=True,
        timeout=60,
        check=True,
    )
    assert json.loads(run.stdout)["coefficients"][0]["value"] == pytest.approx(1.0, rel=0.01)
