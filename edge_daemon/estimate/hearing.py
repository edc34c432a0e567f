"""The noise estimates of one drive, from bursts of waveform or from band levels."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.estimate.noise import NoiseError, NoiseFit, fit_spectrum
from edge_daemon.estimate.spectrum import Spectrum, SpectrumAverage
from edge_daemon.records import Bands, Burst, Estimate, Status
from edge_daemon.settings import Sound

SHAFT_ORDERS = (1, 2, 4)
"""orders of the motor's turn that are left out of the noise: known tones, whether they stand out or not"""
MIN_AVERAGES = 4.0
"""fewer averages than this are still warming up (guess: a quarter of the scatter is then half of the level)"""


class Hearing:
    """Averages the spectrum and fits it anew with each burst."""

    def __init__(self, settings: Sound) -> None:
        self._settings = settings
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
        return self._estimates(time_s)

    @property
    def spectrum(self) -> Spectrum | None:
        """The averaged spectrum that is fitted; None before the first sound."""
        return self._average.spectrum

    def _fit(self, spectrum: Spectrum, speed_in_rad_s: float) -> NoiseFit:
        shaft_hz = abs(speed_in_rad_s) / (2 * math.pi)
        resolved = math.isfinite(shaft_hz) and shaft_hz > 3 * float(np.median(np.diff(spectrum.frequency_hz)))
        tones = tuple(order * shaft_hz for order in SHAFT_ORDERS) if resolved else ()
        return fit_spectrum(spectrum, self._settings.reference_hz, tones)

    def _estimates(self, time_s: float) -> tuple[Estimate, ...]:
        names = [f"noise_a{beta}" for beta in range(5)]
        fit = self.fit
        if fit is None:
            return tuple(
                Estimate(name, math.nan, math.nan, unit, Status.INVALID, time_s)
                for name, unit in [*((name, "1/Hz") for name in names), ("noise_rms", "1")]
            )
        warm = fit.averages >= MIN_AVERAGES
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
