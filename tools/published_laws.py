"""A seventh set of laws that no catalogue lists, after published effects of strain wave gears: softening teeth,
grease that shears thin, friction that fills up with load, clearance that is uneven, bearings that rub at one place.

Each is one simple factor or a product of two. It was written and run before anything was mended for it.
"""

from __future__ import annotations

from math import copysign, exp, sin, tanh

import numpy as np
from outside_laws import OUTPUT_RAD_S, TWIST_RAD_S, drive, of_load, of_spring, torsion

PUBLISHED = (
    torsion("torsion_with_a_power", "an extra spring with a broken power of the twist", of_load,
            {"size": (0.25, 0.4), "power": (1.3, 1.6)},
            lambda i, p, j: p["size"] * copysign((abs(i.phi) / p["twist"]) ** p["power"], i.phi)),
    torsion("mesh_by_place_and_load", "stiffness along the output's turn that grows with the load", of_spring,
            {"size": (0.15, 0.3), "k": (2.0, 8.0), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * i.phi * min(abs(i.phi) / p["twist"], 4.0) * sin(p["k"] * i.angle + p["turn"])),
    torsion("thinning_grease", "drag with a power of speed below one that falls with heat", of_load,
            {"size": (0.4, 0.7), "power": (0.5, 0.8), "per_K": (0.03, 0.08)},
            lambda i, p, j: -p["size"] * copysign((abs(i.speed) / p["speed"]) ** p["power"], i.speed)
            * exp(-p["per_K"] * i.warmer_K), True, warms=True),
    torsion("rough_at_one_speed", "dry output friction that is higher at one speed", of_load,
            {"size": (0.4, 0.7), "at": (0.5, 1.2), "wide": (0.2, 0.5)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S)
            * exp(-(((abs(i.speed) / p["speed"] - p["at"]) / p["wide"]) ** 2)), True),
    torsion("friction_full_of_load", "dry output friction that grows with the load up to a limit", of_load,
            {"size": (0.3, 0.5), "at": (0.3, 0.8)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S)
            * tanh(abs(i.phi) / (p["at"] * p["twist"])), True),
    torsion("uneven_clearance", "a spring beyond a clearance that is wider on one flank", of_spring,
            {"size": (0.5, 0.9), "one": (0.1, 0.3), "other": (0.4, 0.8)},
            lambda i, p, j: p["size"] * (max(i.phi - p["one"] * p["twist"], 0.0)
                                         + min(i.phi + p["other"] * p["twist"], 0.0))),
    torsion("teeth_run_in", "dry friction of the twist that decays from the start", of_load,
            {"size": (0.3, 0.5), "after": (4.0, 12.0)},
            lambda i, p, j: p["size"] * tanh(i.dphi / TWIST_RAD_S) * exp(-max(i.time_s, 0.0) / p["after"]), True),
    torsion("error_by_flank", "a kinematic error of the motor that turns round with the flank", of_load,
            {"size": (0.4, 0.7), "k": (0.5, 3.7), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * tanh(i.phi / (0.2 * p["twist"])) * sin(p["k"] * i.motor + p["turn"])),
    drive("zero_drift_by_place", {"size": (0.02, 0.05), "k": (1.0, 5.0), "turn": (0.0, 6.28)},
          lambda m, p: p["size"] * (m.temperature_degC - 25.0) * np.sin(p["k"] * m.theta_out_rad + p["turn"]),
          warms=True),
    drive("cold_drag", {"size": (0.4, 0.7), "power": (1.2, 1.8), "per_K": (0.03, 0.08)},
          lambda m, p: p["size"] * np.sign(m.speed) * (np.abs(m.speed) / np.std(m.speed)) ** p["power"]
          * np.exp(-p["per_K"] * (m.temperature_degC - 25.0)), warms=True),
    drive("bearing_rubs_by_place_and_load", {"size": (0.3, 0.5), "k": (1.0, 5.0), "turn": (0.0, 6.28)},
          lambda m, p: p["size"] * m.sign * np.abs(m.acceleration) / np.std(m.acceleration)
          * (1 + 0.7 * np.sin(p["k"] * m.theta_out_rad + p["turn"]))),
    drive("limited_drag_from_the_start", {"size": (0.5, 0.8), "at": (0.2, 0.5), "after": (5.0, 12.0)},
          lambda m, p: p["size"] * np.tanh(m.speed / (p["at"] * np.std(m.speed))) * np.exp(-m.time_s / p["after"])),
)  # fmt: skip
