"""A torque that remembers the twist for seconds, which no effect of the catalogue does: creep of flexspline and grease.

Above the frequency of its own time it is what a speed makes, a skew of the encoders or a brake on the output; below it,
it relaxes. It is no candidate, since it is no part of a model yet; but where it does better than the best of them, that
one is not what is missing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from edge_daemon.effects.algebra import stack
from edge_daemon.effects.effect import Effect, EffectState, Parameter
from edge_daemon.records import Array, Motion


def relaxed(twist_rad: Array, rate_hz: float, time_s: float) -> Array:
    """(n,) twist that a damper in series with a spring has given way by, following the whole twist with a time."""
    keep = math.exp(-1.0 / (rate_hz * time_s))
    y, out = float(twist_rad.mean()), []
    for x in twist_rad.tolist():
        y = x + keep * (y - x)
        out.append(y)
    return np.array(out)


def _creep(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    given_way = relaxed(motion.twist_rad, motion.rate_hz, shape["time"])
    begun = np.exp((motion.time_s[0] - motion.time_s) / shape["time"])
    return stack(-given_way, begun), state


CREEP = Effect(
    name="creep",
    balance="torsion",
    kind="torque",
    meaning="a part of the stiffness that gives way in time",
    equation="-dK psi, T dpsi/dt = phi - psi",
    source="standard linear solid: a spring beside a spring and damper in series (Zener 1948)",
    amplitudes=(
        Parameter("stiffness", "N m/rad", "what relaxes", 0.0, 1e7),
        Parameter("before", "N m", "what the twist before the recording left"),
    ),
    shapes=(
        Parameter("time", "s", "after which two thirds of it have given way", 0.02, 30.0, 1.0, "", (0.1, 0.4, 1.6)),
    ),
    columns=_creep,
)
