"""A sixth set of laws that no catalogue lists: each at most two simple factors of the angles, their difference, speed,
torque, temperature and time, as an engineer who knows strain wave gears would write them down at a desk. It was written
and run before the search was mended for it.
"""

from __future__ import annotations

from math import copysign, exp, sin, tanh

import numpy as np
from outside_laws import EDGE_RAD, OUTPUT_RAD_S, TWIST_RAD_S, drive, of_load, of_spring, torsion

SWITCHED_S = 0.05
"""width of a moment"""


ENGINEERED = (
    torsion("friction_with_a_power_of_load", "dry output friction with a power of the load", of_load,
            {"size": (0.25, 0.4), "power": (0.5, 1.7)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * min(abs(i.phi) / p["twist"], 4.0) ** p["power"],
            True),
    torsion("softer_when_fast", "stiffness that falls with speed down to a limit", of_spring,
            {"size": (0.25, 0.4), "at": (0.3, 0.9)},
            lambda i, p, j: -p["size"] * i.phi * tanh(abs(i.speed) / (p["at"] * p["speed"]))),
    torsion("seal_seizes", "dry output friction that is there from one moment on", of_load,
            {"size": (0.4, 0.7), "from": (5.0, 14.0)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S)
            * (0.5 + 0.5 * tanh((i.time_s - p["from"]) / SWITCHED_S)), True),
    torsion("play_that_load_opens", "lost motion that is taken up later the more load there is", of_load,
            {"size": (0.5, 0.8), "gap": (0.2, 0.4), "grows": (0.2, 0.5)},
            lambda i, p, j: -p["size"] * copysign(
                min(abs(i.phi) / p["twist"], p["gap"] + p["grows"] * max(abs(i.phi) / p["twist"] - p["gap"], 0.0)),
                i.phi)),
    torsion("loaded_flank_friction_by_way", "dry friction of the twist, more one way round", of_load,
            {"size": (0.25, 0.4), "share": (0.3, 0.6)},
            lambda i, p, j: p["size"] * tanh(i.dphi / TWIST_RAD_S)
            * (1.0 + p["share"] * tanh(i.speed / OUTPUT_RAD_S)), True),
    torsion("order_that_fades", "an order of the motor that fades in time", of_load,
            {"size": (0.5, 0.8), "k": (0.5, 3.7), "turn": (0.0, 6.28), "after": (4.0, 12.0)},
            lambda i, p, j: -p["size"] * sin(p["k"] * i.motor + p["turn"]) * exp(-max(i.time_s, 0.0) / p["after"])),
    torsion("damped_in_a_sector", "damping of the twist in one sector of the output", of_load,
            {"size": (0.5, 0.9), "at": (-0.12, 0.02), "wide": (0.06, 0.12)},
            lambda i, p, j: p["size"] * i.dphi / p["rate"] * 0.5
            * (tanh((i.angle - p["at"]) / EDGE_RAD) - tanh((i.angle - p["at"] - p["wide"]) / EDGE_RAD))),
    torsion("spring_beyond_a_twist_by_place", "an extra spring beyond one twist, more on one side of the turn",
            of_spring, {"size": (0.5, 0.9), "at": (0.2, 0.6), "k": (2.0, 6.0), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * max(i.phi - p["at"] * p["twist"], 0.0)
            * (1 + 0.7 * sin(p["k"] * i.angle + p["turn"]))),
    drive("friction_with_a_power_of_load", {"size": (0.3, 0.5), "power": (0.5, 1.6)},
          lambda m, p: p["size"] * m.sign * (np.abs(m.acceleration) / np.std(m.acceleration)) ** p["power"]),
    drive("drag_from_a_moment_on", {"size": (0.4, 0.7), "from": (5.0, 14.0)},
          lambda m, p: p["size"] * m.speed / np.std(m.speed)
          * (0.5 + 0.5 * np.tanh((m.time_s - p["from"]) / SWITCHED_S))),
    drive("one_way_friction_that_warms_away", {"size": (0.5, 0.8), "per_K": (0.03, 0.08)},
          lambda m, p: p["size"] * np.where(m.speed > 0, m.sign, 0.3 * m.sign)
          * np.exp(-p["per_K"] * (m.temperature_degC - 25.0)), warms=True),
    drive("order_with_one_sided_load", {"size": (0.4, 0.7), "k": (0.3, 0.9), "turn": (0.0, 6.28), "at": (0.0, 0.5)},
          lambda m, p: p["size"] * np.maximum(m.acceleration / np.std(m.acceleration) - p["at"], 0)
          * np.sin(p["k"] * m.theta_in_rad + p["turn"])),
)  # fmt: skip
