"""Sensors against what they should say: counts, spectrum, warmth."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.rig.sensors import AMBIENT_DEGC, EncoderFace, Housing, Microphone, demo_coefficients

RATE_HZ = 25_600.0


def encoder(bits: int = 17) -> EncoderFace:
    return EncoderFace(bits, np.random.default_rng(1))


def test_counts_are_the_angle_in_steps() -> None:
    angle = np.linspace(-3.0, 50.0, 5000)
    counts = encoder(20).counts(angle)
    error = counts - angle * 2**20 / (2 * np.pi)
    assert error.std() == pytest.approx(np.sqrt(1 / 12 + 0.25**2), rel=0.05)


def test_the_counter_rolls_over_at_32_bits() -> None:
    turns = np.array([2**31 / 2**24 - 0.25, 2**31 / 2**24 + 0.25])
    counts = encoder(24).counts(turns * 2 * np.pi)
    assert counts[0] > 2**31 - 2**23
    assert counts[1] < -(2**31) + 2**23


def test_encoder_faults() -> None:
    angle = np.linspace(1.0, 2.0, 100)
    healthy = encoder().counts(angle)
    frozen = encoder()
    frozen.counts(angle[:10])
    frozen.frozen = True
    assert len(set(frozen.counts(angle).tolist())) == 1
    jumped = encoder()
    jumped.slip(5000 * 2 * np.pi / 2**jumped.bits)
    np.testing.assert_array_equal(jumped.counts(angle), healthy + 5000)
    reset = encoder()
    reset.counts(angle[:1])
    reset.start_again()
    assert abs(int(reset.counts(angle[:1])[0])) < 5


def test_lost_and_dropped_frames() -> None:
    lossy = encoder()
    assert lossy.kept(100).all()
    lossy.loss = 0.1
    assert lossy.kept(10_000).mean() == pytest.approx(0.9, abs=0.02)
    lossy.loss = 1.0
    assert not lossy.kept(100).any()


def welch(sound: np.ndarray, segment: int) -> tuple[np.ndarray, np.ndarray]:
    """One-sided density with Hann windows and half overlap (Welch 1967), in a few lines of numpy."""
    window = np.hanning(segment)
    starts = range(0, len(sound) - segment + 1, segment // 2)
    power = [np.abs(np.fft.rfft(sound[s : s + segment] * window)) ** 2 for s in starts]
    return np.fft.rfftfreq(segment, 1 / RATE_HZ), 2 * np.mean(power, axis=0) / (RATE_HZ * np.sum(window**2))


def test_the_spectrum_of_the_sound_is_the_sum_of_powers() -> None:
    rng = np.random.default_rng(3)
    microphone = Microphone(rng, tones=())
    spectra = [welch(microphone.waveform(np.zeros(16_384), RATE_HZ), 4096) for _ in range(40)]
    frequency = spectra[0][0]
    level = np.mean([power for _, power in spectra], axis=0)
    band = (frequency >= 30.0) & (frequency <= 10_000.0)
    expected = sum(a * (frequency[band] / 300.0) ** -b for b, a in enumerate(demo_coefficients()))
    ratio = level[band] / expected
    scatter = 1 / np.sqrt(40 * 7 / 1.06)  # of one bin; half-overlapped Hann segments are nearly independent
    assert ratio.std() < 1.5 * scatter
    assert ratio.mean() == pytest.approx(1.0, abs=0.01)
    for low, high in ((30, 100), (100, 400), (400, 2000), (2000, 10_000)):
        inside = (frequency[band] >= low) & (frequency[band] < high)
        assert ratio[inside].mean() == pytest.approx(1.0, abs=4 * scatter / np.sqrt(inside.sum()) + 0.02)


def test_band_levels_scatter_like_a_gamma_law() -> None:
    microphone = Microphone(np.random.default_rng(5))
    frequency = np.full(20_000, 1000.0)
    ratio = microphone.bands(frequency, 50.0) / microphone.psd(frequency)
    assert ratio.mean() == pytest.approx(1.0, abs=0.005)
    assert ratio.std() == pytest.approx(1 / np.sqrt(50.0), rel=0.03)


def test_tones_stand_at_orders_of_the_motor() -> None:
    microphone = Microphone(np.random.default_rng(7))
    turns_hz = 40.0
    angle = 2 * np.pi * turns_hz * np.arange(65_536) / RATE_HZ
    frequency, level = welch(microphone.waveform(angle, RATE_HZ), 8192)
    at = int(np.argmin(np.abs(frequency - 4 * turns_hz)))
    assert level[at] > 2 * float(microphone.psd(frequency[at : at + 1])[0])


def test_wear_raises_the_sound() -> None:
    microphone = Microphone(np.random.default_rng(7))
    frequency = np.geomspace(10, 10_000, 50)
    new = microphone.psd(frequency)
    microphone.wear = 0.5
    assert np.all(microphone.psd(frequency) > 1.4 * new)


def test_the_housing_warms_to_where_losses_balance() -> None:
    housing = Housing(np.random.default_rng(1))
    for _ in range(100):
        housing.advance(60.0, 200.0)
    assert housing.temperature_degC == pytest.approx(AMBIENT_DEGC + 0.9 * 0.105 * 200.0, abs=0.01)
    expected = 101_325.0 * (housing.temperature_degC + 273.15) / 298.15
    assert housing.measured()[1] == pytest.approx(expected, abs=10.0)
