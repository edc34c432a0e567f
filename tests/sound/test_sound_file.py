"""Sounds of known spectrum in files of every kind, written here byte by byte, read back by the noise fit."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
import soundfile

from edge_daemon.errors import BadInput
from edge_daemon.sound.sound_file import fit_sound_file

REFERENCE_HZ = 300.0
EQUAL = np.ones(5)
EXTENSIBLE_TAIL = bytes.fromhex("000000001000800000aa00389b71")


def density(a: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    return np.asarray(sum(a[b] * (frequency / REFERENCE_HZ) ** -b for b in range(5)))


def sound(a: np.ndarray, rate: float, seconds: float, seed: int, below_hz: float = 10.0) -> np.ndarray:
    """Gaussian noise of the density; below `below_hz` it is flat: a steep spectrum must not leak into the band."""
    rng, n = np.random.default_rng(seed), int(rate * seconds)
    frequency = np.fft.rfftfreq(n, 1 / rate)
    power = density(a, np.maximum(frequency, below_hz))
    power[0] = 0.0
    lines = rng.normal(size=len(frequency)) + 1j * rng.normal(size=len(frequency))
    return np.fft.irfft(lines * np.sqrt(power * rate * n / 4), n)


def write_wav(
    path: Path, channels: np.ndarray, rate: int, bits: int, floating: bool = False, extensible: bool = False
) -> Path:
    """`channels` (c, n) in parts of full scale."""
    frames = np.ascontiguousarray(channels.T)
    if floating:
        data = frames.astype(f"<f{bits // 8}").tobytes()
    elif bits == 8:
        data = np.clip(np.round(frames * 128) + 128, 0, 255).astype(np.uint8).tobytes()
    else:
        whole = 2.0 ** (bits - 1)
        counts = np.clip(np.round(frames * whole), -whole, whole - 1).astype("<i8")
        data = counts.view(np.uint8).reshape(-1, 8)[:, : bits // 8].tobytes()
    kind, width = 3 if floating else 1, len(channels) * bits // 8
    head = struct.pack("<HHIIHH", 0xFFFE if extensible else kind, len(channels), rate, rate * width, width, bits)
    if extensible:
        head += struct.pack("<HHIH", 22, bits, 0, kind) + EXTENSIBLE_TAIL
    odd = b"LIST" + struct.pack("<I", 5) + b"INFO \0"
    body = b"WAVEfmt " + struct.pack("<I", len(head)) + head + odd + b"data" + struct.pack("<I", len(data)) + data
    path.write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)
    return path


def write_csv(path: Path, header: str, *columns: np.ndarray, fmt: str = "%.9g") -> Path:
    np.savetxt(path, np.column_stack(columns), fmt=fmt, delimiter=",", header=header, comments="")
    return path


def test_a_steep_spectrum_is_not_blurred_nor_leaked_into(tmp_path: Path) -> None:
    """The window spreads f^-4 over several bins; what goes on below the band is as strong as nature made it."""
    scores = []
    for seed in range(24):
        below_hz = (0.5, 3.0, 10.0)[seed % 3]
        value = sound(EQUAL, 16_000, 6.0, seed, below_hz)
        scale = 0.1 / value.std()
        fit, _, notes = fit_sound_file(write_wav(tmp_path / "a.wav", (scale * value)[None], 16_000, 32, floating=True))
        assert notes == () and fit.iterations <= 10 and not fit.tones
        scores.append((fit.value / scale**2 - EQUAL) * scale**2 / fit.sd)
    spread = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all((spread > 0.6) & (spread < 1.4)), spread
    assert np.abs(np.mean(scores, axis=0)).max() < 0.6  # three sd of a mean of 24


@pytest.mark.parametrize(
    ("rate", "bits", "channels", "floating", "extensible"),
    [
        (8000, 16, 1, False, False),
        (16_000, 24, 2, False, True),
        (22_050, 32, 1, False, False),
        (44_100, 32, 2, True, True),
        (8000, 64, 1, True, False),
    ],
)
def test_every_kind_of_wav(
    tmp_path: Path, rate: int, bits: int, channels: int, floating: bool, extensible: bool
) -> None:
    value = sound(EQUAL, rate, 8.0, rate)
    scale = 0.1 / value.std()
    both = np.stack([scale * value, np.zeros(len(value))])[:channels]
    fit, unit, notes = fit_sound_file(write_wav(tmp_path / "a.wav", both, rate, bits, floating, extensible))
    assert unit == "FS^2/Hz" and len(notes) == channels - 1
    assert np.all(np.abs(fit.value / scale**2 - EQUAL) < 4 * fit.sd / scale**2)


def test_the_rounding_of_eight_bits_is_not_the_sounds_own(tmp_path: Path) -> None:
    value = sound(np.array([0.02, 0.1, 1.0, 0.0, 0.0]), 8000, 20.0, 3)
    scale = 0.02 / value.std()
    fit, _, _ = fit_sound_file(write_wav(tmp_path / "a.wav", (scale * value)[None], 8000, 8))
    rounding = (1 / 128) ** 2 / 12 * 2 / 8000
    assert rounding > 20 * fit.sd[0]  # it would be seen
    assert abs(fit.value[0] - 0.02 * scale**2) < 4 * fit.sd[0]


def test_tones_have_their_frequency_and_level_also_side_by_side(tmp_path: Path) -> None:
    value = sound(EQUAL, 25_600, 10.0, 4)
    t = np.arange(len(value)) / 25_600
    truth = {91.37: 300.0, 97.9: 200.0, 1000.21: 30.0, 5000.7: 10.0}
    for i, (frequency, level) in enumerate(truth.items()):
        value = value + level * math.sqrt(2) * np.sin(2 * math.pi * frequency * t + i)
    fit, _, _ = fit_sound_file(write_csv(tmp_path / "a.csv", "time_s,sound", t, value))
    assert len(fit.tones) == len(truth)
    for tone, (frequency, level) in zip(fit.tones, truth.items(), strict=True):
        assert tone.frequency_hz == pytest.approx(frequency, abs=0.1)
        assert tone.level == pytest.approx(level, rel=0.03, abs=0.7)  # two sd of ten seconds in this noise
    assert np.all(np.abs(fit.value - EQUAL) < 4 * fit.sd)


def test_times_may_be_rounded_rows_may_lack_and_the_zero_may_lie_in_1970(tmp_path: Path) -> None:
    value = sound(EQUAL, 25_600, 4.0, 5)
    t = np.arange(len(value)) / 25_600
    exact = fit_sound_file(write_csv(tmp_path / "a.csv", "time_s,sound", t, value)).fit
    for fmt, shift in (("%.6f", 0.0), ("%.5f", 0.0), ("%.6f", 1.7e9)):
        rounded = fit_sound_file(write_csv(tmp_path / "b.csv", "time_s,sound", t + shift, value, fmt=fmt)).fit
        np.testing.assert_allclose(rounded.value, exact.value, rtol=1e-3)
    kept = np.ones(len(t), dtype=bool)
    kept[50_000:50_900] = False
    fit, _, notes = fit_sound_file(write_csv(tmp_path / "c.csv", "time_s,sound", t[kept], value[kept], fmt="%.6f"))
    assert "900 samples missing" in notes[0]
    assert np.all(np.abs(fit.value - EQUAL) < 4 * fit.sd)


def test_lost_samples_are_named(tmp_path: Path) -> None:
    value = sound(EQUAL, 8000, 4.0, 6)
    value[np.random.default_rng(0).random(len(value)) < 0.005] = math.nan
    t = np.arange(len(value)) / 8000
    fit, _, notes = fit_sound_file(write_csv(tmp_path / "a.csv", "time_s,sound", t, value))
    assert "samples missing" in notes[0]
    assert np.all(np.abs(fit.value - EQUAL) < 4 * fit.sd + 0.02)


def test_a_clipped_stretch_is_left_out(tmp_path: Path) -> None:
    value = sound(EQUAL, 8000, 20.0, 7)
    scale = 0.1 / value.std()
    value[30_000:30_020] *= 1e3 / np.abs(value[30_000:30_020]).min() / scale  # a hammer blow
    fit, _, notes = fit_sound_file(write_wav(tmp_path / "a.wav", (scale * value)[None], 8000, 16))
    assert "20 clipped" in notes[0]
    assert np.all(np.abs(fit.value / scale**2 - EQUAL) < 4 * fit.sd / scale**2)


def test_averages_of_each_bin_count(tmp_path: Path) -> None:
    """Bands of a third of an octave have more averages the higher they lie; and the order of rows is free."""
    rng = np.random.default_rng(8)
    frequency = np.geomspace(12.5, 10_000, 60)
    averages = np.maximum(1.0, frequency)
    scores = []
    for _ in range(60):
        psd = density(EQUAL, frequency) * rng.gamma(averages, 1 / averages)
        order = rng.permutation(60)
        file = write_csv(tmp_path / "a.csv", "frequency_hz,psd,averages", frequency[order], psd[order], averages[order])
        fit = fit_sound_file(file).fit
        scores.append((fit.value - EQUAL) / fit.sd)
    spread = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all((spread > 0.75) & (spread < 1.25)), spread


@pytest.mark.parametrize("between", [";", "\t"])
def test_a_table_as_an_office_program_writes_it_reads_the_same(tmp_path: Path, between: str) -> None:
    """Semicolons or tabs between the cells, commas in the numbers, an empty cell, and the mark in front."""
    frequency = np.geomspace(12.5, 10_000, 60)
    file = write_csv(
        tmp_path / "a.csv", "frequency_hz,psd,averages", frequency, density(EQUAL, frequency), np.full(60, 64.0)
    )
    exact = fit_sound_file(file).fit
    text = file.read_text().rstrip("\n").replace(",", between).replace(".", ",")
    for more in ("", f"\n11000{between}{between}64"):
        (tmp_path / "b.csv").write_text("\ufeff" + text + more + "\n")
        np.testing.assert_allclose(fit_sound_file(tmp_path / "b.csv").fit.value, exact.value, rtol=1e-9)


def test_bins_of_a_window_that_hang_together_are_noticed(tmp_path: Path) -> None:
    """A spectrum from elsewhere: overlapping Hann segments whose bins are not independent, as nobody says."""
    scores = []
    for seed in range(30):
        value = sound(EQUAL, 8000, 20.0, seed, 1.0).reshape(-1, 8000)
        window = np.hanning(8001)[:-1]
        psd = (np.abs(np.fft.rfft(value * window)) ** 2).mean(axis=0) * 2 / 8000 / (window @ window)
        frequency = np.arange(len(psd)) * 1.0
        used = (frequency > 30) & (frequency < 3600)
        file = write_csv(
            tmp_path / "a.csv", "frequency_hz,psd,averages", frequency[used], psd[used], np.full(used.sum(), 20.0)
        )
        fit = fit_sound_file(file).fit
        scores.append((fit.value - EQUAL) / fit.sd)
    spread = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all(spread < 1.3), spread  # 1.4 if taken for independent


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (np.zeros(8000), "all samples are 0"),
        (np.full(8000, 0.3), "all samples are 0.3"),
        (np.zeros(0), "too short"),
        (np.zeros(1000), "too short"),
    ],
)
def test_a_sound_that_is_none_is_refused(tmp_path: Path, value: np.ndarray, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        fit_sound_file(write_wav(tmp_path / "a.wav", value[None], 8000, 32, floating=True))


def test_flac_reads_as_the_wav_it_was_made_of(tmp_path: Path) -> None:
    value = sound(EQUAL, 16_000, 8.0, 5)
    wav = write_wav(tmp_path / "a.wav", (0.1 / value.std() * value)[None], 16_000, 24)
    soundfile.write(tmp_path / "a.flac", *soundfile.read(wav), subtype="PCM_24")
    fits = [fit_sound_file(tmp_path / name)[0].value for name in ("a.wav", "a.flac")]
    assert fits[0] == pytest.approx(fits[1], rel=1e-12)


def test_a_codec_that_loses_some_of_the_sound_is_refused(tmp_path: Path) -> None:
    soundfile.write(tmp_path / "a.wav", np.zeros(8000), 8000, subtype="ULAW")
    with pytest.raises(BadInput, match=r"U-Law, 8000 samples: expected PCM"):
        fit_sound_file(tmp_path / "a.wav")


def test_a_file_that_was_cut_off_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    value = sound(EQUAL, 8000, 10.0, 9)
    file = write_wav(tmp_path / "a.wav", (0.1 / value.std() * value)[None], 8000, 16)
    whole = file.read_bytes()
    file.write_bytes(whole[:100_000])
    fit, _, notes = fit_sound_file(file)
    assert fit.averages > 5
    there = 80_000 - (len(whole) - 100_000) // 2
    assert notes == (f"cut off: {there} of 80000 samples are there",)
    file.write_bytes(file.read_bytes()[:30])
    with pytest.raises(BadInput, match="no sound file that can be read"):
        fit_sound_file(file)
