"""How what comparing and diagnosing found is read, alike on the terminal, in a report and on the page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge_daemon.explain.results import Candidate, Error, ParameterLine
from edge_daemon.records import Array
from edge_daemon.text import with_sd

ADEQUATE = 1.2
"""Up to this error over noise floor nothing counts as left."""
SURE = 0.5
"""Below this probability another cause is as likely as the one named."""
SHOWN_S = 2.0
"""So much of the measured and the modelled side by side shows both ways of a motion."""
BINS = 60
PARAMETER_HEAD = ("effect", "parameter", "value", "unit", "identified")


class Axis(NamedTuple):
    """What a residual can be drawn over."""

    field: str
    """of the series"""
    meaning: str
    unit: str
    """empty: that of the error"""
    period: float = 0.0
    """into which it is folded"""


AXES = {
    "input angle": Axis("theta_in_rad", "input angle within a turn", "rad", 2 * np.pi),
    "output angle": Axis("theta_out_rad", "output angle", "rad"),
    "twist": Axis("twist_rad", "twist", "rad"),
    "twist rate": Axis("twist_rate_rad_s", "twist rate", "rad/s"),
    "direction": Axis("twist_rate_rad_s", "twist rate", "rad/s"),
    "speed": Axis("speed_out_rad_s", "output speed", "rad/s"),
    "torque": Axis("torque", "measured torque", ""),
    "temperature": Axis("temperature_degC", "temperature", "degC"),
    "time": Axis("time_s", "time", "s"),
}
"""Axes stand here by the names that comparing gives them."""


def adequate(error: Error) -> bool:
    """Whether the sensors' noise explains the error."""
    return error.nrmse <= ADEQUATE * error.noise_floor_nrmse


def times_noise(error: Error) -> float:
    """The error over what the sensors' noise alone would make."""
    return error.nrmse / error.noise_floor_nrmse if error.noise_floor_nrmse else float("inf")


def is_guess(best: Candidate) -> bool:
    """Whether another cause is as likely."""
    return best.probability < SURE


def parameter_cells(rows: Sequence[ParameterLine]) -> list[tuple[str, str, str, str, str]]:
    """A table's rows under `PARAMETER_HEAD`."""
    return [
        (row.effect, row.name, with_sd(row.value, row.sd), row.unit, "yes" if row.identified else f"no: {row.advice}")
        for row in rows
    ]


def filled(at: Array) -> list[NDArray[np.intp]]:
    """Indices of `BINS` bins along `at`, each with as many samples as the others."""
    return np.array_split(np.argsort(at), BINS)
