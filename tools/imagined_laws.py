"""Further laws that no catalogue lists, as a mechanical engineer of strain wave gears may imagine them: single ones,
and such of two or three causes, some of which remember what the gear has been through.

`OPEN` is there to be looked at when something is mended, `CLOSED` only to be counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import copysign, cos, exp, log1p, sin, sqrt, tanh

import numpy as np
from compiled_laws import CREEPS_S, HEATS_S
from numpy.random import Generator
from outside_laws import (
    EDGE_RAD,
    OUTPUT_RAD_S,
    TWIST_RAD_S,
    Instant,
    Ranges,
    Stepwise,
    drive,
    of_load,
    of_spring,
    torsion,
)

from edge_daemon.records import Array
from edge_daemon.rig.drive_truth import Moving
from edge_daemon.rig.plant import Influence, Joint
from edge_daemon.rig.torsion_truth import LEAD_IN_S
from edge_daemon.rig.truths import Parameters, Scale, Truth


@dataclass(frozen=True, slots=True)
class Past(Instant):
    """With what the output has been through."""

    since_s: float
    """since it turned round"""
    way_rad: float
    """that it has gone, there and back"""
    heat: float
    """square of its speed, smoothed over `HEATS_S`"""
    crept: float
    """the twist, smoothed over `CREEPS_S`"""


@dataclass(frozen=True, slots=True)
class Remembering(Stepwise):
    """A law that knows it."""

    start: tuple[float, ...] = (-LEAD_IN_S, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """the time, and what `Past` has; output speed and twist last, and the speed before"""

    @property
    def remembers(self) -> str:
        return "past"

    def at(
        self, z: Sequence[float], step_s: float, phi: float, dphi: float, speed: float, angle: float
    ) -> tuple[float, float]:
        z[5:7] = speed, phi  # type: ignore[index]
        motor = self.joint.ratio * (angle + phi)
        now = (angle, motor, z[0] + 0.5 * step_s, *z[1:5])
        torque = self.law(Past(phi, dphi, speed, *now), self.p, self.joint)
        if not self.steep:
            return torque, 0.0
        moved = self.law(Past(phi, dphi + 1e-6, speed - 1e-6, *now), self.p, self.joint)
        return torque, (moved - torque) / 1e-6

    def grown(self, z: Sequence[float], step_s: float, dphi: float) -> Sequence[float]:
        speed, phi, before = z[5:]
        since = 0.0 if speed * before < 0 else z[1] + step_s
        heat = z[3] + step_s / HEATS_S * (speed**2 - z[3])
        crept = z[4] + step_s / CREEPS_S * (phi - z[4])
        return z[0] + step_s, since, z[2] + step_s * abs(speed), heat, crept, speed, phi, speed


def past(
    name: str, meaning: str, ranges: Ranges, law: Callable[[Past, Parameters, Joint], float], steep: bool = False
) -> Truth:
    """A row whose law remembers; its size is over the load."""

    def draw(rng: Generator, scale: Scale, joint: Joint) -> dict[str, float]:
        rows = {key: float(rng.uniform(*ends)) for key, ends in ranges.items()}
        rows |= {"twist": scale.twist_rad, "rate": scale.twist_rate_rad_s, "speed": scale.speed_out_rad_s}
        return rows | {"size": rows["size"] * scale.torque_Nm}

    return Truth(name, meaning, draw, lambda p, j: Influence(twist=Remembering(law, p, j, steep)))  # type: ignore[arg-type]


def _window(at: float, begin: float, wide: float) -> float:
    return 0.5 * (tanh((at - begin) / EDGE_RAD) - tanh((at - begin - wide) / EDGE_RAD))


def _signed(speed: float, power: float) -> float:
    return copysign(abs(speed) ** power, speed)


OPEN_TORSION = (
    torsion("churning", "drag with a power of speed that thins with heat", of_load,
            {"size": (0.5, 0.9), "power": (0.6, 1.4), "per_K": (0.03, 0.07)},
            lambda i, p, j: -p["size"] * _signed(i.speed / p["speed"], p["power"]) * exp(-p["per_K"] * i.warmer_K),
            warms=True),
    torsion("missing_contact", "stiffness that is lost in a part of the turn", of_spring,
            {"size": (0.25, 0.4), "at": (-0.1, 0.05), "wide": (0.06, 0.12)},
            lambda i, p, j: -p["size"] * i.phi * _window(i.angle, p["at"], p["wide"])),
    past("breaks_away", "output friction that falls off after a reversal",
         {"size": (0.4, 0.7), "after": (0.05, 0.3)},
         lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * exp(-i.since_s / p["after"]), True),
    past("grease_pushed_aside", "drag that falls with the way gone", {"size": (0.5, 0.9), "way": (0.8, 2.5)},
         lambda i, p, j: -p["size"] * i.speed / p["speed"] * exp(-i.way_rad / p["way"])),
    torsion("gap_by_place", "lost motion that is wider on one side of the turn", of_load,
            {"size": (0.4, 0.6), "gap": (0.3, 0.6), "k": (2.0, 8.0), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * min(max(i.phi / p["twist"], -p["gap"]), p["gap"])
            * (1 + 0.7 * sin(p["k"] * i.angle + p["turn"]))),
    torsion("eccentric_load_friction", "friction with the load, more on one side of the turn", of_load,
            {"size": (0.2, 0.4), "k": (2.0, 6.0), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * min(abs(i.phi) / p["twist"], 4.0)
            * (1 + 0.8 * sin(p["k"] * i.angle + p["turn"])), True),
    torsion("cogging_late_with_speed", "cogging whose phase lags with speed", of_load,
            {"size": (0.4, 0.7), "k": (0.6, 3.0), "lag": (0.5, 1.2)},
            lambda i, p, j: -p["size"] * sin(p["k"] * i.motor - p["lag"] * i.speed / p["speed"])),
    torsion("one_sided_square", "a stiffness that grows with load on one side", of_load, {"size": (0.2, 0.35)},
            lambda i, p, j: p["size"] * max(i.phi / p["twist"], 0.0) ** 2),
    torsion("wave_generator_throw", "unbalance of the wave generator: with the square of speed", of_load,
            {"size": (0.3, 0.6), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * min((i.speed / p["speed"]) ** 2, 4.0) * sin(2 * i.motor + p["turn"])),
)  # fmt: skip
CLOSED_TORSION = (
    torsion("cold_stick", "friction that falls with speed and with heat", of_load,
            {"size": (0.6, 0.9), "at": (0.3, 0.8), "per_K": (0.03, 0.07)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * exp(-abs(i.speed) / (p["at"] * p["speed"]))
            * exp(-p["per_K"] * i.warmer_K), True, warms=True),
    torsion("stiff_beyond_a_speed", "stiffness that comes with speed and is full from one speed on", of_spring,
            {"size": (0.2, 0.4), "at": (0.3, 0.8)},
            lambda i, p, j: p["size"] * i.phi * i.speed**2 / (i.speed**2 + (p["at"] * p["speed"]) ** 2)),
    past("warms_itself", "drag that its own motion warms away", {"size": (0.6, 0.9), "per": (0.8, 2.0)},
         lambda i, p, j: -p["size"] * i.speed / p["speed"] * exp(-p["per"] * i.heat / p["speed"] ** 2)),
    torsion("seal_under_load", "drag with the root of speed and the load", of_load, {"size": (0.3, 0.6)},
            lambda i, p, j: -p["size"] * _signed(i.speed / p["speed"], 0.5) * min(abs(i.phi) / p["twist"], 4.0), True),
    torsion("friction_of_one_quadrant", "friction of one flank in one direction", of_load, {"size": (0.5, 0.9)},
            lambda i, p, j: -p["size"] * (0.5 + 0.5 * tanh(i.speed / OUTPUT_RAD_S))
            * min(max(i.phi, 0.0) / p["twist"], 4.0), True),
    torsion("cage_wobble", "an order of the cage that grows with the load", of_load,
            {"size": (0.3, 0.6), "k": (0.4, 0.6), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * min(abs(i.phi) / p["twist"], 4.0) * sin(p["k"] * i.motor + p["turn"])),
    torsion("growing_error", "kinematic error that grows with heat", of_load,
            {"size": (0.2, 0.4), "per_K": (0.05, 0.12), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * sin(2 * i.motor + p["turn"]) * p["per_K"] * i.warmer_K, warms=True),
    past("creeping_spring", "a part of the spring that creeps", {"size": (0.3, 0.6)},
         lambda i, p, j: -p["size"] * i.crept / p["twist"]),
    torsion("friction_ages", "dry twist friction that grows with the logarithm of time", of_load,
            {"size": (0.15, 0.3), "after": (0.5, 2.0)},
            lambda i, p, j: p["size"] * tanh(i.dphi / TWIST_RAD_S) * log1p(max(i.time_s, 0.0) / p["after"]), True),
    torsion("flank_damping_by_place", "damping of one flank along the turn", of_load,
            {"size": (0.4, 0.7), "k": (2.0, 6.0)},
            lambda i, p, j: p["size"] * i.dphi / p["rate"] * min(max(i.phi, 0.0) / p["twist"], 4.0)
            * (1 + 0.8 * cos(p["k"] * i.angle))),
    torsion("root_spring", "a soft spring of the root of the twist on one side", of_load, {"size": (0.3, 0.5)},
            lambda i, p, j: p["size"] * sqrt(max(i.phi, 0.0) / p["twist"])),
)  # fmt: skip


def _since_s(m: Moving) -> Array:
    """(n,) since the output turned round."""
    turned = np.concatenate([[True], m.speed[1:] * m.speed[:-1] < 0])
    return np.asarray(m.time_s - np.maximum.accumulate(np.where(turned, m.time_s, -np.inf)))


def _way_rad(m: Moving) -> Array:
    """(n,) way that the output has gone."""
    return np.asarray(np.cumsum(np.abs(m.speed)) * (m.time_s[1] - m.time_s[0]))


def _come_up(m: Moving, way_rad: float) -> Array:
    """(n,) friction that comes up over a way, from none (Dahl 1968), sample by sample."""
    z, out = 0.0, []
    for step in np.diff(m.theta_out_rad, prepend=m.theta_out_rad[0]).tolist():
        way = copysign(1.0, step)
        z = way - (way - z) * exp(-abs(step) / way_rad)
        out.append(z)
    return np.array(out)


OPEN_DRIVE = (
    drive("breaks_away", {"size": (0.4, 0.7), "after": (0.05, 0.3)},
          lambda m, p: p["size"] * m.sign * (1 + np.exp(-_since_s(m) / p["after"]))),
    drive("churning", {"size": (0.4, 0.7), "power": (0.6, 1.4), "per_K": (0.03, 0.07)},
          lambda m, p: p["size"] * np.sign(m.speed) * np.abs(m.speed / np.std(m.speed)) ** p["power"]
          * np.exp(-p["per_K"] * (m.temperature_degC - 25.0)), warms=True),
    drive("harness", {"size": (0.2, 0.4), "at": (-0.5, 0.5)},
          lambda m, p: p["size"] * np.maximum(m.theta_out_rad - p["at"], 0) ** 2),
    drive("stiff_cable", {"size": (0.4, 0.7), "over": (0.1, 0.3)}, lambda m, p: p["size"] * _come_up(m, p["over"])),
    drive("seal_swells", {"size": (0.3, 0.5)},
          lambda m, p: p["size"] * m.speed / np.std(m.speed) * (1 + (m.temperature_degC - 25.0) / 5), warms=True),
    drive("runs_in", {"size": (0.4, 0.7), "after": (2.0, 6.0)},
          lambda m, p: p["size"] * m.sign / (1 + m.time_s / p["after"])),
)  # fmt: skip
CLOSED_DRIVE = (
    drive("seal_under_load", {"size": (0.3, 0.6)},
          lambda m, p: p["size"] * np.sign(m.speed) * np.sqrt(np.abs(m.speed) / np.std(m.speed))
          * np.abs(m.acceleration) / np.std(m.acceleration)),
    drive("cogging_late_with_speed", {"size": (0.3, 0.6), "k": (0.3, 0.9), "lag": (0.4, 1.0)},
          lambda m, p: p["size"] * np.sin(p["k"] * m.theta_in_rad - p["lag"] * m.speed / np.std(m.speed))),
    drive("grease_pushed_aside", {"size": (0.5, 0.9), "way": (2.0, 6.0)},
          lambda m, p: p["size"] * m.speed / np.std(m.speed) * np.exp(-_way_rad(m) / p["way"])),
    drive("drives_or_is_driven", {"size": (0.4, 0.7)},
          lambda m, p: p["size"] * m.sign * (m.speed * m.acceleration > 0) * np.abs(m.acceleration)
          / np.std(m.acceleration)),
)  # fmt: skip
OPEN = (*OPEN_TORSION, *OPEN_DRIVE)
CLOSED = (*CLOSED_TORSION, *CLOSED_DRIVE)
