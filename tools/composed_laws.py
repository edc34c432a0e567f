"""A fifth set of laws that no catalogue lists, composed as a physicist of real gears would: films, seals, wear, play,
creep and resonance. It was written before the search was mended last, and nothing was tuned on it.
"""

from __future__ import annotations

from math import copysign, exp, sin, tanh

import numpy as np
from drawn_laws import Lived, LivedInstant
from fresh_laws import wave_of_angle
from imagined_laws import past
from numpy.random import Generator
from outside_laws import EDGE_RAD, OUTPUT_RAD_S, drive, of_load, torsion

from edge_daemon.records import Array
from edge_daemon.rig.drive_truth import Moving
from edge_daemon.rig.plant import Influence, Joint
from edge_daemon.rig.truths import Parameters, Scale, Truth


def _inside(at: float, begin: float, wide: float) -> float:
    return 0.5 * (tanh((at - begin) / EDGE_RAD) - tanh((at - begin - wide) / EDGE_RAD))


def _relaxing() -> Truth:
    """A part of the spring that lets go of its load, more on one side of the turn."""

    def draw(rng: Generator, scale: Scale, joint: Joint) -> dict[str, float]:
        size, twist = float(rng.uniform(0.4, 0.7)) * scale.torque_Nm, scale.twist_rad
        rows = {"k": (2.0, 6.0), "turn": (0.0, 6.28), "relaxes": (0.05, 0.4)}
        return {"size": size, "twist": twist} | {key: float(rng.uniform(*ends)) for key, ends in rows.items()}

    def law(i: LivedInstant, p: Parameters, j: Joint) -> float:
        return p["size"] * i.held / p["twist"] * (1 + 0.7 * sin(p["k"] * i.angle + p["turn"]))

    def build(p: Parameters, joint: Joint) -> Influence:
        return Influence(twist=Lived(law, p, joint, False, relaxes_s=p["relaxes"]))  # type: ignore[arg-type]

    return Truth("hysteretic_damping", "a relaxing spring along the turn", draw, build)


COMPOSED_TORSION = (
    torsion("film_thickness", "friction with the load that falls as the film builds up with speed", of_load,
            {"size": (0.3, 0.5), "at": (0.2, 0.6)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * min(abs(i.phi) / p["twist"], 4.0)
            / (1 + abs(i.speed) / (p["at"] * p["speed"])), True),
    past("wearing_in", "dry friction that wears off with the turns made", {"size": (0.5, 0.8), "way": (0.8, 2.5)},
         lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * exp(-i.way_rad / p["way"]), True),
    torsion("warm_backlash", "lost motion that widens as the gear warms", of_load,
            {"size": (0.5, 0.8), "gap": (0.2, 0.4), "per_K": (0.03, 0.08)},
            lambda i, p, j: -p["size"] * min(max(i.phi / p["twist"], -p["gap"] * (1 + p["per_K"] * i.warmer_K)),
                                             p["gap"] * (1 + p["per_K"] * i.warmer_K)), warms=True),
    torsion("load_zone_ripple", "ripple of a free order of the motor with the square of the load", of_load,
            {"size": (0.3, 0.6), "k": (0.5, 3.5), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * min((i.phi / p["twist"]) ** 2, 4.0) * sin(p["k"] * i.motor + p["turn"])),
    torsion("sector_drag", "viscous drag in one sector of the turn", of_load,
            {"size": (0.6, 0.9), "at": (-0.1, 0.05), "wide": (0.06, 0.12)},
            lambda i, p, j: -p["size"] * i.speed / p["speed"] * _inside(i.angle, p["at"], p["wide"])),
    torsion("cogging_of_two_orders", "cogging with its third harmonic", of_load,
            {"size": (0.3, 0.6), "k": (0.4, 1.2), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * (sin(p["k"] * i.motor + p["turn"]) + 0.5 * sin(3 * p["k"] * i.motor))),
    past("seal_that_swells", "seal friction that comes up as the gear warms itself",
         {"size": (0.5, 0.8), "per": (0.5, 1.5)},
         lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * (1 - exp(-p["per"] * i.heat / p["speed"] ** 2)),
         True),
    torsion("one_way_drag_in_the_cold", "drag one way round that thins with heat", of_load,
            {"size": (0.5, 0.9), "per_K": (0.03, 0.08)},
            lambda i, p, j: -p["size"] * max(i.speed, 0.0) / p["speed"] * exp(-p["per_K"] * i.warmer_K), warms=True),
    torsion("coupling_play", "a spring at the output beyond its play", of_load,
            {"size": (4.0, 8.0), "gap": (0.05, 0.15)},
            lambda i, p, j: -p["size"] * copysign(max(abs(i.angle) - p["gap"], 0.0), i.angle)),
    _relaxing(),
    wave_of_angle("interpolation_error", "an angle error at a part of the motor's order", 0.3, 0.8, False),
    torsion("bracket_resonance", "an order of the motor that shakes the bracket near one speed", of_load,
            {"size": (0.6, 1.0), "k": (0.6, 2.5), "at": (0.5, 1.0), "wide": (0.2, 0.4), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * sin(p["k"] * i.motor + p["turn"])
            / (1 + ((abs(i.speed) / p["speed"] - p["at"]) / p["wide"]) ** 2)),
    past("sheared_grease", "damping of the twist that its motion shears thin", {"size": (0.5, 0.8), "per": (0.8, 2.0)},
         lambda i, p, j: p["size"] * i.dphi / p["rate"] / (1 + p["per"] * i.heat / p["speed"] ** 2)),
)  # fmt: skip


def _followed(m: Moving, after_s: float) -> Array:
    """(n,) the speed as a relaxing coupling passes it on."""
    keep, out = float(np.exp(-(m.time_s[1] - m.time_s[0]) / after_s)), np.zeros(len(m.time_s))
    for i in range(1, len(out)):
        out[i] = keep * out[i - 1] + (1 - keep) * m.speed[i]
    return out


COMPOSED_DRIVE = (
    drive("film_friction", {"size": (0.5, 0.8), "at": (0.3, 0.8), "per_K": (0.03, 0.07)},
          lambda m, p: p["size"] * m.sign * np.exp(-np.abs(m.speed) / (p["at"] * np.std(m.speed)))
          * np.exp(-p["per_K"] * (m.temperature_degC - 25.0)), warms=True),
    drive("wearing_in", {"size": (0.5, 0.9), "way": (2.0, 6.0)},
          lambda m, p: p["size"] * m.sign
          * np.exp(-np.cumsum(np.abs(m.speed)) * (m.time_s[1] - m.time_s[0]) / p["way"])),
    drive("arm_in_one_quadrant", {"size": (0.3, 0.6), "turn": (0.0, 6.28)},
          lambda m, p: p["size"] * np.maximum(m.acceleration, 0.0) / np.std(m.acceleration)
          * np.cos(m.theta_out_rad + p["turn"])),
    drive("late_drag", {"size": (0.4, 0.7), "after": (0.1, 0.5)},
          lambda m, p: p["size"] * _followed(m, p["after"]) / np.std(m.speed)),
    drive("drag_one_way_by_place", {"size": (0.4, 0.7), "k": (1.0, 5.0)},
          lambda m, p: p["size"] * np.where(m.speed > 0, m.speed, 0.4 * m.speed) / np.std(m.speed)
          * (1 + 0.5 * np.sin(p["k"] * m.theta_out_rad))),
)  # fmt: skip
COMPOSED = (*COMPOSED_TORSION, *COMPOSED_DRIVE)
