"""Materials, surface treatments and the fatigue safety they give."""

from __future__ import annotations

import functools
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from statistics import NormalDist
from typing import Any

from edge_daemon.design.drawing import DesignError, MaterialKeys
from edge_daemon.text import meant

FIGURES = ("youngs_modulus_GPa", "poisson", "density_kg_m3", "yield_MPa", "ultimate_MPa", "endurance_MPa", "slope")
NEEDED = FIGURES[:3]
SCATTER = 0.08
"""Standard deviation of endurance limits, as a share (Shigley, Mechanical Engineering Design, 2011, section 6-9)."""
SLOPE = 9.0
"""Of an S-N curve that is not given: steel's from 0.9 of the ultimate at 1e3 cycles (Shigley, section 6-8)."""
KNEE_CYCLES = 1e6
"""Where a steel's S-N curve ends in its endurance limit (Shigley, section 6-8)."""
ENDURANCE_SHARE, MOST_ENDURANCE_MPA = 0.5, 700.0
"""An unknown endurance limit is half the ultimate strength and no more than 700 MPa (Shigley, equation 6-8)."""


@dataclass(frozen=True, slots=True)
class Material:
    """Figures of one material with its surface; strengths are NaN where they are not known. Stresses [Pa]."""

    name: str
    youngs_Pa: float
    poisson: float
    density_kg_m3: float
    yield_Pa: float
    ultimate_Pa: float
    endurance_Pa: float
    slope: float
    surface: str
    residual_Pa: float
    factor: float
    reliability: float
    source: str

    @property
    def allowed_amplitude_Pa(self) -> float:
        """Endurance limit of the treated surface that `reliability` of the parts reach."""
        return self.endurance_Pa * self.factor * (1.0 - SCATTER * NormalDist().inv_cdf(self.reliability))

    def safety(self, amplitude_Pa: float, mean_Pa: float) -> float:
        """Modified Goodman: 1 / (amplitude / endurance + mean / ultimate); compression is not counted as a gain.

        NaN where the strength is not known.
        """
        if math.isnan(self.ultimate_Pa) or math.isnan(self.endurance_Pa):
            return math.nan
        mean = max(mean_Pa + self.residual_Pa, 0.0)
        used = amplitude_Pa / self.allowed_amplitude_Pa + mean / self.ultimate_Pa
        return 1.0 / used if used > 0.0 else math.inf

    def cycles(self, amplitude_Pa: float, mean_Pa: float) -> float:
        """Cycles to failure: Basquin's line below the knee, without end at safety 1 and more."""
        safety = self.safety(amplitude_Pa, mean_Pa)
        return math.inf if safety >= 1.0 else KNEE_CYCLES * safety**self.slope


@functools.cache
def shelf() -> Mapping[str, Any]:
    """The table that is shipped."""
    return tomllib.loads(resources.files(__package__).joinpath("materials.toml").read_text())


def find_material(keys: MaterialKeys) -> Material:
    """The material of a file: by name, by numbers, or both."""
    rows = {name.lower(): name for name in shelf()["material"]}
    row: Mapping[str, Any] = {"figures": (), "treatments": list(shelf()["surface"]), "source": "user's numbers"}
    name = keys.name or "user's"
    if keys.name is not None and keys.name.lower() in rows:
        name = rows[keys.name.lower()]
        row = shelf()["material"][name]
    figures = dict(zip(FIGURES, row["figures"], strict=False))
    figures |= {key: value for key in FIGURES if (value := getattr(keys, key, None)) is not None}
    if any(key not in figures for key in NEEDED):
        _refuse(keys, list(rows.values()))
    return _made(name, figures, keys, row)


def _refuse(keys: MaterialKeys, known: list[str]) -> None:
    if keys.name is not None:
        raise DesignError(f"material.name: {keys.name!r} is not in the table: {meant(keys.name, known)}")
    missing = [key for key in NEEDED if getattr(keys, key) is None]
    raise DesignError(f"material: expected a name, or numbers: {', '.join(missing)} missing")


def _made(name: str, figures: Mapping[str, float], keys: MaterialKeys, row: Mapping[str, Any]) -> Material:
    surface = keys.surface.lower().replace(" ", "_").replace("-", "_")
    treatments = shelf()["surface"]
    if surface not in treatments:
        raise DesignError(f"material.surface: {keys.surface!r}: {meant(surface, treatments)}")
    if surface != "none" and surface not in row["treatments"]:
        raise DesignError(f"material.surface: {name} is not given {surface.replace('_', ' ')}")
    ultimate = figures.get("ultimate_MPa", math.nan)
    endurance = figures.get("endurance_MPa", min(ENDURANCE_SHARE * ultimate, MOST_ENDURANCE_MPA))
    strength = figures.get("yield_MPa", math.nan)
    residual = treatments[surface]["residual"] * strength if surface != "none" else 0.0
    return Material(
        name=name,
        youngs_Pa=figures["youngs_modulus_GPa"] * 1e9,
        poisson=figures["poisson"],
        density_kg_m3=figures["density_kg_m3"],
        yield_Pa=strength * 1e6,
        ultimate_Pa=ultimate * 1e6,
        endurance_Pa=endurance * 1e6,
        slope=figures.get("slope", SLOPE),
        surface=surface,
        residual_Pa=residual * 1e6,
        factor=treatments[surface]["factor"],
        reliability=keys.reliability,
        source=row["source"],
    )
