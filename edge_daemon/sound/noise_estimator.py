"""The noise estimates of one drive, from bursts of waveform or from band levels."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from edge_daemon.channels import MOTOR_ORDERS
from edge_daemon.config.settings import Sound
from edge_daemon.records import Bands, Burst, Estimate, Status
from edge_daemon.sound.noise_baseline import NoiseBaseline
from edge_daemon.sound.noise_model import NoiseError, NoiseFit, fit_noise
from edge_daemon.sound.spectrum import Spectrum, SpectrumAverage

LONGEST_STEP_S = 60.0
"""Two sounds this far apart still count as heard without a pause."""
MIN_AVERAGES = 4.0
"""Fewer averages than this are still warming up (guess: a quarter of the scatter is then half of the level)."""


class NoiseEstimator:
    """Averages the spectrum and fits it anew with each burst."""

    def __init__(self, settings: Sound, baseline_after_s: float = math.inf) -> None:
        self._settings = settings
        self.baseline = NoiseBaseline(baseline_after_s)
        self._heard_s = math.nan
        self._average = SpectrumAverage(settings.low_hz, settings.high_hz, settings.forget_s)
        self.fit: NoiseFit | None = None

    def update(self, sound: Burst | Bands, speed_in_rad_s: float) -> tuple[Estimate, ...]:
        """The estimates of the topic `noise` after this burst; invalid with NaN where it cannot be fitted."""
        if isinstance(sound, Burst):
            taken = self._average.add_waveform(sound.time_s, np.asarray(sound.value, dtype=float), sound.rate_hz)
            time_s = sound.time_s + len(sound.value) / sound.rate_hz
        else:
            taken, time_s = self._average.add_bands(sound), sound.time_s
        spectrum = self._average.spectrum
        try:
            self.fit = self._fit(spectrum, speed_in_rad_s) if taken and spectrum is not None else None
        except NoiseError:
            self.fit = None
        if self.fit is not None and self.warm:
            step_s = time_s - self._heard_s
            self.baseline.follow(self.fit.value, step_s if 0.0 < step_s < LONGEST_STEP_S else 0.0)
        self._heard_s = time_s
        return self._estimates(time_s)

    def state(self) -> bytes:
        """The commissioning baseline, for a checkpoint."""
        return msgspec.json.encode({"key": self._key(), "baseline": self.baseline.dump()})

    def restore(self, blob: bytes) -> bool:
        """Take a checkpoint back; False, and nothing changed, when it is broken or of another sensor or band."""
        try:
            state: dict[str, Any] = msgspec.json.decode(blob, type=dict[str, Any])
            if state["key"] != self._key():
                return False
            self.baseline.load(state["baseline"])
        except (msgspec.DecodeError, KeyError, TypeError, ValueError):
            return False
        return True

    def _key(self) -> list[str]:
        row = self._settings
        return [row.source, row.signal, repr(row.reference_hz), repr(row.low_hz), repr(row.high_hz)]

    @property
    def warm(self) -> bool:
        """Whether there are averages enough for the fit to mean something."""
        return self.fit is not None and self.fit.averages >= MIN_AVERAGES

    @property
    def spectrum(self) -> Spectrum | None:
        """The averaged spectrum that is fitted; None before the first sound."""
        return self._average.spectrum

    @property
    def reference_hz(self) -> float:
        """Frequency at which every term of the noise model is as large as its coefficient."""
        return self._settings.reference_hz

    def _fit(self, spectrum: Spectrum, speed_in_rad_s: float) -> NoiseFit:
        shaft_hz = abs(speed_in_rad_s) / (2 * math.pi)
        resolved = math.isfinite(shaft_hz) and shaft_hz > 3 * float(np.median(np.diff(spectrum.frequency_hz)))
        tones = tuple(order * shaft_hz for order in MOTOR_ORDERS) if resolved else ()  # known, whether they stand out
        return fit_noise(spectrum, self._settings.reference_hz, tones)

    def _estimates(self, time_s: float) -> tuple[Estimate, ...]:
        names = [f"noise_a{beta}" for beta in range(5)]
        fit = self.fit
        if fit is None:
            return tuple(
                Estimate(name, math.nan, math.nan, unit, Status.INVALID, time_s)
                for name, unit in [*((name, "1/Hz") for name in names), ("noise_rms", "1")]
            )
        warm = self.warm
        known = Status.VALID if warm else Status.WARMING_UP
        unknown = Status.NOT_EXCITED if warm else Status.WARMING_UP
        rows = zip(names, fit.value, fit.sd, fit.identified, strict=True)
        return (
            *(
                Estimate(n, float(v), float(sd), "1/Hz", known if found else unknown, time_s)
                for n, v, sd, found in rows
            ),
            Estimate("noise_rms", fit.rms, fit.rms_sd, "1", known, time_s),
        )
