"""What the simulated drive is measured with: encoders, a microphone, a temperature and a pressure sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array

Counts = NDArray[np.int64]

COUNTER_BITS = 32
ENCODER_NOISE_STEPS = 0.25
"""An encoder's noise has this sd before rounding, in its steps (guess; as in recordings)."""
BURST, BURST_EVERY = 50, 500
"""Samples that a burst of noise lasts, and from one to the next: something switches beside the cable (guess)."""


@dataclass(slots=True)
class EncoderFace:
    """Absolute encoder with a signed 32-bit counter that rolls over, and the ways in which such a thing fails."""

    bits: int
    rng: np.random.Generator
    noise_steps: float = ENCODER_NOISE_STEPS
    """sd before rounding"""
    loss: float = 0.0
    """share of its frames that get lost at random"""
    delay_s: float = 0.0
    """age of a position at the instant that its stamp tells"""
    frozen: bool = False
    stuck_bit: int | None = None
    """number of the bit that always reads 1; 0 is the finest"""
    sticking_bit: int | None = None
    """number of the bit that reads 1 in the two fifths of the turn about zero, as a scratch on its track makes it"""
    lost_bits: int = 0
    """the finest bits, which always read 0"""
    drift: float = 0.0
    """seconds by which its positions grow older in a second: its clock is another than that of the stamps"""
    repeated: float = 0.0
    """share of its frames that tell the position of the one before"""
    bit_errors: float = 0.0
    """share of its frames in which one bit is wrong"""
    burst_steps: float = 0.0
    """sd of the noise in bursts of `BURST` samples, one in `BURST_EVERY`"""
    eccentric_rad: float = 0.0
    """amplitude of an error once per turn of its shaft"""
    _gain: float = 1.0
    _anchor_rad: float = 0.0
    _offset: int = 0
    _last: int = 0
    _angle_rad: float = 0.0
    _read: int = 0
    """positions since the start"""

    def ages(self, n: int, period_s: float) -> Array:
        """(n,) ages [s] of the next positions."""
        ages: Array = self.delay_s + self.drift * period_s * np.arange(n, dtype=np.float64)
        self.delay_s += self.drift * period_s * n
        return ages

    def counts(self, angle_rad: Array) -> Counts:
        """(n,) counter values in [-2^31, 2^31) at the true angles, the present faults included."""
        told = self._anchor_rad + self._gain * (angle_rad - self._anchor_rad)
        if self.eccentric_rad:
            told = told + self.eccentric_rad * (np.sin(angle_rad) - math.sin(self._anchor_rad))
        exact = told * (2**self.bits / (2 * math.pi))
        steps = np.rint(exact + self.rng.normal(0.0, self._noise_steps(len(exact)), len(exact))).astype(np.int64)
        if self.frozen:
            return np.full(len(steps), self._last)
        steps = steps + self._offset >> self.lost_bits << self.lost_bits
        if self.stuck_bit is not None:
            steps |= 1 << self.stuck_bit
        if self.sticking_bit is not None:
            place = 5 * (steps % (1 << self.bits)) >> self.bits
            steps = np.where((place == 0) | (place == 4), steps | 1 << self.sticking_bit, steps)
        if self.bit_errors:
            wrong = self.rng.random(len(steps)) < self.bit_errors
            steps ^= np.where(wrong, 1 << self.rng.integers(0, self.bits, len(steps)), 0)
        half = 1 << (COUNTER_BITS - 1)
        wrapped = (steps + half) % (2 * half) - half
        if self.repeated:
            own = self.rng.random(len(steps)) >= self.repeated
            newest = np.maximum.accumulate(np.where(own, np.arange(1, len(steps) + 1), 0))
            wrapped = np.concatenate(([self._last], wrapped))[newest]
        if len(wrapped):
            self._last, self._angle_rad = int(wrapped[-1]), float(angle_rad[-1])
        return np.asarray(wrapped)

    def _noise_steps(self, n: int) -> Array | float:
        """(n,) sd of the next positions' noise, or the one of all."""
        at = self._read + np.arange(n)
        self._read += n
        if not self.burst_steps:
            return self.noise_steps
        return np.where(at % BURST_EVERY >= BURST_EVERY - BURST, self.burst_steps, self.noise_steps)

    def kept(self, n: int) -> NDArray[np.bool_]:
        """(n,) which of the next frames arrive."""
        return self.rng.random(n) >= self.loss if self.loss else np.ones(n, dtype=bool)

    def turn_with(self, gain: float) -> None:
        """From where it stands now it counts `gain` times the true motion: lines lost or doubled, or -1 backward."""
        self._gain, self._anchor_rad = gain, self._angle_rad

    def slip(self, angle_rad: float) -> None:
        """Its coupling slips on the shaft, or its zero is set anew."""
        self._offset += round(angle_rad * 2**self.bits / (2 * math.pi))

    def start_again(self) -> None:
        """Power fails for a moment: it counts from about zero."""
        self._offset -= self._last


class SoundTone(NamedTuple):
    """A line in the sound, at a multiple of the motor's turn."""

    order: float
    amplitude: float
    """[Pa]"""


EXPONENTS = 5
REFERENCE_HZ = 300.0
LOW_HZ, HIGH_HZ = 10.0, 10_000.0
"""The articles use this band."""
CORNERS_HZ = (2000.0, 500.0, 120.0, 30.0)
"""Here one power of 1/f hands over to the next, so that each coefficient owns a part of the band (chosen)."""
FLOOR_PA2_PER_HZ = 1e-8
"""With this level at the upper end and the rest the sound has about 0.1 Pa rms, 74 dB: a gear close by (chosen)."""
TONES = (SoundTone(1.0, 2e-3), SoundTone(2.0, 5e-3), SoundTone(4.0, 5e-3))
"""Tones are plain to see at one speed; a motion through all speeds spreads them to some per cent of the noise below 200
Hz."""
WEAR_GROWTH = (1.0, 1.0, 2.0, 3.0, 1.0)
"""From new to worn out each coefficient grows by this, relatively: the middle of the band first (chosen)."""


def demo_coefficients() -> tuple[float, ...]:
    """a0..a4 [Pa^2/Hz] of `sum a_b (f/300 Hz)^-b` with corners at `CORNERS_HZ`."""
    values = [FLOOR_PA2_PER_HZ]
    for corner in CORNERS_HZ:
        values.append(values[-1] * corner / REFERENCE_HZ)
    return tuple(values)


@dataclass(slots=True)
class Microphone:
    """Sound with the spectrum of the articles, tones at shaft orders, and growth with wear."""

    rng: np.random.Generator
    coefficients: tuple[float, ...] = field(default_factory=demo_coefficients)
    tones: tuple[SoundTone, ...] = TONES
    wear: float = 0.0

    def present_coefficients(self) -> tuple[float, ...]:
        """a0..a4 [Pa^2/Hz] at the present wear."""
        return tuple(a * (1.0 + g * self.wear) for a, g in zip(self.coefficients, WEAR_GROWTH, strict=True))

    def psd(self, frequency_hz: Array) -> Array:
        """(n,) one-sided power density [Pa^2/Hz] without the tones; below 10 Hz the microphone rolls off."""
        x = np.maximum(frequency_hz, LOW_HZ) / REFERENCE_HZ
        level = sum(a * x**-b for b, a in enumerate(self.present_coefficients()))
        return np.asarray(level * np.minimum(1.0, frequency_hz / LOW_HZ) ** 2)

    def waveform(self, motor_angle_rad: Array, rate_hz: float) -> Array:
        """(n,) sound pressure [Pa], as many samples as motor angles; each call is an independent stretch.

        Gaussian noise shaped in the frequency domain, cut out of twice the length so that its ends do not meet.
        """
        n = len(motor_angle_rad)
        length = 1 << (2 * n - 1).bit_length()
        frequency: Array = np.arange(length // 2 + 1, dtype=np.float64) * (rate_hz / length)
        size = np.sqrt(self.psd(frequency) * rate_hz * length / 4)
        spectrum = size * (self.rng.normal(size=len(size)) + 1j * self.rng.normal(size=len(size)))
        sound: Array = np.fft.irfft(spectrum, length)[:n]
        for tone in self.tones:
            sound = sound + tone.amplitude * np.sin(tone.order * motor_angle_rad)
        return sound

    def bands(self, frequency_hz: Array, averages: float) -> Array:
        """(n,) band levels [Pa^2/Hz] as a sensor with its own FFT reports them: Gamma scatter of `averages`."""
        return np.asarray(self.psd(frequency_hz) * self.rng.gamma(averages, 1.0 / averages, len(frequency_hz)))


AMBIENT_DEGC = 25.0
AMBIENT_PA = 101_325.0
THERMAL_RESISTANCE_K_PER_W = 0.9
THERMAL_TIME_S = 600.0
"""A small gear on an aluminium flange warms up in ten minutes (guess)."""
NO_LOAD_TORQUE_NM = 0.105
"""Size 20 runs without load at 2000 rpm and 20 degC with this torque (maker's table)."""
TEMPERATURE_NOISE_K = 0.01
PRESSURE_NOISE_PA = 1.5
"""A BMP280 has this noise of its own (data sheet table 2)."""


@dataclass(slots=True)
class Housing:
    """Temperature with one time constant, heated by friction; a closed housing's pressure follows it."""

    rng: np.random.Generator
    temperature_degC: float = AMBIENT_DEGC
    sensor_error_K: float = 0.0
    """what the thermometer tells above the truth"""

    def advance(self, seconds: float, motor_speed_rad_s: float) -> None:
        """Friction at a mean motor speed magnitude for a while."""
        final = AMBIENT_DEGC + THERMAL_RESISTANCE_K_PER_W * NO_LOAD_TORQUE_NM * motor_speed_rad_s
        self.temperature_degC += (final - self.temperature_degC) * -math.expm1(-seconds / THERMAL_TIME_S)

    @property
    def pressure_Pa(self) -> float:
        """Of the air enclosed at ambient conditions (ideal gas)."""
        return AMBIENT_PA * (self.temperature_degC + 273.15) / (AMBIENT_DEGC + 273.15)

    def measured(self) -> tuple[float, float]:
        """Temperature [degC] and pressure [Pa] with the sensors' noise."""
        temperature = self.temperature_degC + self.sensor_error_K + self.rng.normal(0.0, TEMPERATURE_NOISE_K)
        return float(temperature), float(self.pressure_Pa + self.rng.normal(0.0, PRESSURE_NOISE_PA))
