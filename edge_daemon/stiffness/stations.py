"""A stiffness of no law as an effect: a curve over the twist that goes from station to station."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge_daemon.effects.expression import LETTERS
from edge_daemon.effects.model import Model, ModelError
from edge_daemon.identify.problem import problem_of
from edge_daemon.records import Recorded

STIFFNESS_FORMS = {"stiffness_table": 2, "stiffness_spline": 3}
"""Forms of K(phi) by the power of the torque's pieces: K goes straight from station to station, or bends between."""
STIFFNESS_STATIONS = (0.0, 0.4, 0.7, 0.9)
"""Stations to either side of zero twist, by the share of the time that the gear is nearer to zero (guess)."""


def stiffness_form(recordings: Sequence[Recorded], model: Model, name: str) -> str:
    """The torque that K(phi) has beyond the linear spring's, its stations where these recordings twist the gear: none
    of them is a law of stiffness, all of them together follow any. Raises `BadInput`."""
    if model.balance != "torsion":
        raise ModelError(f"joint.balance: {model.balance!r}: expected 'torsion': a stiffness wants two encoders")
    twist = np.abs(np.concatenate([motion.twist_rad for motion in problem_of(recordings, model).motions]))
    at = np.unique([float(f"{q:.3g}") for q in np.quantile(twist[np.isfinite(twist)], STIFFNESS_STATIONS[1:])])
    power = STIFFNESS_FORMS[name]
    sides = [(side, f"{sign}{x:g}") for x in at for side, sign in (("maximum", "-"), ("minimum", "+"))]
    pieces = [f"{side}(twist_rad, 0)**{power}" for side in ("maximum", "minimum")]
    pieces += [f"{side}(twist_rad {x}, 0)**{power}" for side, x in sides]
    return " + ".join(f"{name}*{piece}" for name, piece in zip(LETTERS, pieces, strict=False))
