"""Laws that no catalogue of gears lists, for the simulated drive: each with sizes drawn to be material.

Written as an engineer would say them, in both balances. They are handed to `rig.recording.simulate` as `laws`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, fields
from math import copysign, cos, exp, sin, tanh

import numpy as np
from compiled_laws import SLOPE_STEP_RAD_S, WARM_UP_K, WARM_UP_S, compiled_law
from numpy.random import Generator

from edge_daemon.records import Array
from edge_daemon.rig.drive_truth import DriveTruth
from edge_daemon.rig.plant import Influence, Joint
from edge_daemon.rig.torsion_truth import LEAD_IN_S
from edge_daemon.rig.truths import Parameters, Scale, Truth


@dataclass(frozen=True, slots=True)
class Instant:
    """What a law may see, at one instant; output side."""

    phi: float
    dphi: float
    speed: float
    angle: float
    motor: float
    time_s: float

    @property
    def warmer_K(self) -> float:
        """Above the start."""
        return WARM_UP_K * (1 - exp(-max(self.time_s, 0.0) / WARM_UP_S))


Law = Callable[[Instant, Parameters, Joint], float]


@dataclass(frozen=True, slots=True)
class Stepwise:
    """A law as the plant evaluates it: with its own clock, and its slope over the twist rate by a difference."""

    law: Law
    p: Parameters
    joint: Joint
    steep: bool
    start: tuple[float, ...] = (-LEAD_IN_S,)

    def at(
        self, z: Sequence[float], step_s: float, phi: float, dphi: float, speed: float, angle: float
    ) -> tuple[float, float]:
        time_s = z[0] + 0.5 * step_s
        torque = self._torque(time_s, phi, dphi, speed, angle)
        if not self.steep:
            return torque, 0.0
        moved = self._torque(time_s, phi, dphi + SLOPE_STEP_RAD_S, speed - SLOPE_STEP_RAD_S, angle)
        return torque, (moved - torque) / SLOPE_STEP_RAD_S

    def _torque(self, time_s: float, phi: float, dphi: float, speed: float, angle: float) -> float:
        motor = self.joint.ratio * (angle + phi)
        return self.law(Instant(phi, dphi, speed, angle, motor, time_s), self.p, self.joint)

    def grown(self, z: Sequence[float], step_s: float, dphi: float) -> Sequence[float]:
        return (z[0] + step_s,)

    @property
    def numbers(self) -> tuple[float, ...]:
        """As its machine code has them."""
        return tuple(float(x) for x in (*astuple(self.joint), *self.p.values()))

    def code(self) -> tuple[object, object] | None:
        """Machine code of a law that is one line."""
        names = (*(f"j.{field.name}" for field in fields(self.joint)), *(f"p.{name}" for name in self.p))
        return compiled_law(self.law, names, self.steep, self.remembers)

    @property
    def remembers(self) -> str:
        """By what rule, of `compiled_laws.MEMORIES`."""
        return "time" if type(self) is Stepwise else ""


Ranges = dict[str, tuple[float, float]]


def torsion(
    name: str, meaning: str, size: Callable[[Scale, Joint], float], ranges: Ranges, law: Law, steep: bool = False,
    warms: bool = False,
) -> Truth:  # fmt: skip
    """A row; `size` is the unit of the parameter `size`, the others are drawn as they are."""

    def draw(rng: Generator, scale: Scale, joint: Joint) -> dict[str, float]:
        rows = {key: float(rng.uniform(*ends)) for key, ends in ranges.items()}
        return rows | {"size": rows["size"] * size(scale, joint)} | _scales(scale)

    return Truth(name, meaning, draw, lambda p, j: Influence(twist=Stepwise(law, p, j, steep)), warms)


def _scales(scale: Scale) -> dict[str, float]:
    """What laws measure twist, rate and speed by."""
    return {"twist": scale.twist_rad, "rate": scale.twist_rate_rad_s, "speed": scale.speed_out_rad_s}


def of_load(s: Scale, j: Joint) -> float:
    """Unit of a size that is over the load."""
    return s.torque_Nm


def of_spring(s: Scale, j: Joint) -> float:
    """The same over the stiffness."""
    return j.stiffness_Nm_per_rad


OUTPUT_RAD_S, TWIST_RAD_S = 1e-2, 1e-3
"""widths of a sign"""
EDGE_RAD = 5e-3
"""of a place where a law begins"""

TORSION = (
    torsion("waves_of_both_angles", "sin(k theta_out) cos(theta_in / n)", of_load,
            {"size": (0.4, 0.7), "k": (5.0, 12.0), "n": (4.0, 9.0)},
            lambda i, p, j: -p["size"] * sin(p["k"] * i.angle) * cos(i.motor / p["n"])),
    torsion("square_of_angle", "a load that grows with the output angle squared", of_load,
            {"size": (1.0, 2.0)}, lambda i, p, j: -p["size"] * i.angle**2),
    torsion("friction_by_place", "dry output friction that changes along the turn", of_load,
            {"size": (0.25, 0.4), "k": (3.0, 8.0), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * sin(p["k"] * i.angle + p["turn"]), True),
    torsion("square_damping", "damping with the square of the twist rate", of_load,
            {"size": (0.25, 0.4)}, lambda i, p, j: p["size"] * i.dphi * abs(i.dphi) / p["rate"] ** 2),
    torsion("one_way_damping", "damping in one direction of the twist rate only", of_load,
            {"size": (0.3, 0.5)}, lambda i, p, j: p["size"] * max(i.dphi, 0.0) / p["rate"]),
    torsion("limited_drag", "output friction that saturates with speed", of_load,
            {"size": (0.3, 0.5), "at": (0.2, 0.5)},
            lambda i, p, j: -p["size"] * tanh(i.speed / (p["at"] * p["speed"]))),
    torsion("end_stop", "a spring beyond one angle of the output", of_load,
            {"size": (4.0, 8.0), "at": (0.05, 0.2)}, lambda i, p, j: -p["size"] * max(i.angle - p["at"], 0.0)),
    torsion("stick_spot", "dry friction at one place", of_load,
            {"size": (0.4, 0.7), "at": (-0.1, 0.15), "wide": (0.04, 0.08)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * exp(-(((i.angle - p["at"]) / p["wide"]) ** 2)),
            True),
    torsion("warming_drag", "viscous output friction that fades in time", of_load,
            {"size": (0.4, 0.7), "after": (5.0, 12.0)},
            lambda i, p, j: -p["size"] * i.speed / p["speed"] * exp(-i.time_s / p["after"])),
    torsion("ripple_by_load", "stiffness with an order of the motor that is no whole number",
            lambda s, j: j.stiffness_Nm_per_rad, {"size": (0.2, 0.35), "k": (1.2, 3.4), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * i.phi * sin(p["k"] * i.motor + p["turn"])),
    torsion("detent", "a detent of the motor, of a free order", of_load,
            {"size": (0.3, 0.5), "k": (0.2, 0.9), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * sin(p["k"] * i.motor + p["turn"])),
    torsion("stiffness_by_place", "stiffness along the output's turn", lambda s, j: j.stiffness_Nm_per_rad,
            {"size": (0.2, 0.35), "k": (1.0, 4.0)}, lambda i, p, j: p["size"] * i.phi * cos(p["k"] * i.angle)),
    torsion("one_sided_spring", "stiffer beyond one twist", lambda s, j: j.stiffness_Nm_per_rad,
            {"size": (0.5, 0.9), "at": (0.3, 0.8)},
            lambda i, p, j: p["size"] * max(i.phi - p["at"] * p["twist"], 0.0)),
    torsion("warm_churning", "drag with the square of speed that warms away", of_load,
            {"size": (0.4, 0.7), "per_K": (0.03, 0.06)},
            lambda i, p, j: -p["size"] * copysign(i.speed**2, i.speed) / p["speed"] ** 2
            * exp(-p["per_K"] * i.warmer_K), warms=True),
    torsion("hump_of_speed", "drag that falls again with speed", of_load,
            {"size": (0.6, 1.0), "at": (0.3, 0.6)},
            lambda i, p, j: -p["size"] * i.speed / p["speed"] / (1 + (i.speed / p["at"] / p["speed"]) ** 2)),
    torsion("drag_by_load", "viscous output friction that grows with the load", of_load,
            {"size": (0.3, 0.5)},
            lambda i, p, j: -p["size"] * i.speed / p["speed"] * abs(i.phi) / p["twist"]),
    torsion("growing_unbalance", "a load along the turn that grows in time", of_load,
            {"size": (0.4, 0.7), "k": (2.0, 6.0)},
            lambda i, p, j: -p["size"] * i.time_s / 20.0 * sin(p["k"] * i.angle)),
    torsion("exponential_drag", "a drag that grows exponentially with speed", of_load,
            {"size": (0.05, 0.1), "at": (0.7, 1.0)},
            lambda i, p, j: -p["size"] * exp(i.speed / p["at"] / p["speed"])),
    torsion("misaligned_friction", "twist friction that depends on the output angle", of_load,
            {"size": (0.25, 0.4), "k": (2.0, 6.0)},
            lambda i, p, j: p["size"] * tanh(i.dphi / TWIST_RAD_S) * (1 + 0.8 * sin(p["k"] * i.angle)), True),
    torsion("limited_damping", "damping that saturates with the twist rate", of_load,
            {"size": (0.3, 0.5), "at": (0.3, 0.6)},
            lambda i, p, j: p["size"] * tanh(i.dphi / (p["at"] * p["rate"]))),
)  # fmt: skip
"""Laws of a joint with two encoders; positive with the twist."""

LATER_TORSION = (
    torsion("friction_in_a_sector", "dry output friction beyond one angle of the output", of_load,
            {"size": (0.3, 0.5), "at": (-0.1, 0.15)},
            lambda i, p, j: -p["size"] / 2 * tanh(i.speed / OUTPUT_RAD_S) * (1 + tanh((i.angle - p["at"]) / EDGE_RAD)),
            True),
    torsion("damping_by_place", "damping of the twist along the turn", of_load,
            {"size": (0.3, 0.5), "k": (2.0, 6.0), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * i.dphi / p["rate"] * (1 + sin(p["k"] * i.angle + p["turn"]))),
    torsion("sided_stiffness", "stiffer one way round", lambda s, j: j.stiffness_Nm_per_rad,
            {"size": (0.2, 0.4)}, lambda i, p, j: p["size"] * abs(i.phi)),
    torsion("limited_spring", "a second spring that gives way at a torque", of_load,
            {"size": (0.4, 0.7), "at": (0.3, 0.7)},
            lambda i, p, j: p["size"] * tanh(i.phi / (p["at"] * p["twist"]))),
    torsion("growing_friction", "dry output friction that comes up as the gear runs", of_load,
            {"size": (0.4, 0.6), "after": (5.0, 12.0)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * (1 - exp(-max(i.time_s, 0.0) / p["after"]))),
    torsion("frozen_friction", "dry output friction that warms away", of_load,
            {"size": (0.4, 0.6), "per_K": (0.04, 0.1)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * exp(-p["per_K"] * i.warmer_K),
            True, warms=True),
    torsion("cubed_drag", "output drag with the cube of speed", of_load,
            {"size": (0.1, 0.2)}, lambda i, p, j: -p["size"] * (i.speed / p["speed"]) ** 3),
    torsion("loaded_damping", "damping that grows with the square of the twist", of_load,
            {"size": (0.2, 0.4)}, lambda i, p, j: p["size"] * i.dphi / p["rate"] * (i.phi / p["twist"]) ** 2),
    torsion("mesh_under_load", "an odd order of the motor that grows with the load, whichever way it goes", of_load,
            {"size": (0.2, 0.4), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * abs(i.phi) / p["twist"] * sin(3 * i.motor + p["turn"])),
    torsion("rubbing_seal", "dry output friction, stronger on one side of the turn", of_load,
            {"size": (0.3, 0.5), "share": (0.4, 0.8), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * (1 + p["share"] * sin(i.angle + p["turn"])),
            True),
)  # fmt: skip
"""Further ones, written when the search for formulas was done and run before it was mended."""

LAST_TORSION = (
    torsion("ageing_spring", "stiffness that runs down as it runs", lambda s, j: j.stiffness_Nm_per_rad,
            {"size": (0.2, 0.4)}, lambda i, p, j: -p["size"] * i.phi * i.time_s / 20.0),
    torsion("sided_by_motion", "stiffer one way of motion", lambda s, j: j.stiffness_Nm_per_rad,
            {"size": (0.15, 0.3)}, lambda i, p, j: p["size"] * i.phi * tanh(i.speed / OUTPUT_RAD_S)),
    torsion("drag_by_place", "viscous output friction along the turn", of_load,
            {"size": (0.4, 0.7), "k": (2.0, 7.0), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * i.speed / p["speed"] * (1 + sin(p["k"] * i.angle + p["turn"]))),
    torsion("humming_motor", "a whole order of the motor that grows with the size of speed", of_load,
            {"size": (0.3, 0.6), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * abs(i.speed) / p["speed"] * sin(5 * i.motor + p["turn"])),
    torsion("shaking_floor", "a torque of one frequency in time", of_load,
            {"size": (0.3, 0.6), "Hz": (2.0, 9.0), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * sin(2 * np.pi * p["Hz"] * i.time_s + p["turn"])),
    torsion("warm_root_drag", "drag with the root of speed that falls straight with temperature", of_load,
            {"size": (0.5, 0.9), "per_K": (0.02, 0.04)},
            lambda i, p, j: -p["size"] * copysign(abs(i.speed / p["speed"]) ** 0.5, i.speed)
            * (1 - p["per_K"] * i.warmer_K), True, warms=True),
    torsion("squared_load_friction", "dry output friction with the square of the torque, up to a size", of_load,
            {"size": (0.15, 0.3)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * min((i.phi / p["twist"]) ** 2, 4.0), True),
    torsion("cold_damping", "damping of the twist that warms away", of_load,
            {"size": (0.4, 0.7), "per_K": (0.04, 0.08)},
            lambda i, p, j: p["size"] * i.dphi / p["rate"] * exp(-p["per_K"] * i.warmer_K), warms=True),
    torsion("mesh_in_a_sector", "an order of the motor in one part of the turn", of_load,
            {"size": (0.5, 0.9), "at": (-0.1, 0.15), "wide": (0.06, 0.1), "k": (1.3, 2.7)},
            lambda i, p, j: -p["size"] * sin(p["k"] * i.motor) * exp(-(((i.angle - p["at"]) / p["wide"]) ** 2))),
)  # fmt: skip
"""Such as a colleague elsewhere may think of; run before anything was done about them."""


def drive(name: str, ranges: Ranges, torque: Callable[[object, Parameters], Array], warms: bool = False) -> DriveTruth:
    """A row; `size` is over the rms of the inertia torque."""

    def draw(rng: Generator, rms: float) -> dict[str, float]:
        rows = {key: float(rng.uniform(*ends)) for key, ends in ranges.items()}
        return rows | {"size": rows["size"] * rms}

    return DriveTruth(name, draw, torque, warms=warms)


DRIVE = (
    drive("waves_of_both", {"size": (0.4, 0.7), "k": (3.0, 9.0), "n": (4.0, 9.0)},
          lambda m, p: p["size"] * np.sin(p["k"] * m.theta_out_rad) * np.cos(m.theta_in_rad / p["n"])),
    drive("square_of_angle", {"size": (0.1, 0.2)}, lambda m, p: p["size"] * m.theta_out_rad**2),
    drive("friction_by_place", {"size": (0.3, 0.5), "k": (1.0, 5.0)},
          lambda m, p: p["size"] * m.sign * np.sin(p["k"] * m.theta_out_rad)),
    drive("square_drag", {"size": (0.2, 0.4)}, lambda m, p: p["size"] * m.speed * np.abs(m.speed)),
    drive("end_stop", {"size": (0.6, 1.0), "at": (0.0, 0.8)},
          lambda m, p: p["size"] * np.maximum(m.theta_out_rad - p["at"], 0)),
    drive("fading_friction", {"size": (0.4, 0.7), "after": (5.0, 12.0)},
          lambda m, p: p["size"] * m.sign * np.exp(-m.time_s / p["after"])),
    drive("stick_spot", {"size": (0.5, 0.8), "at": (-0.5, 0.5), "wide": (0.1, 0.3)},
          lambda m, p: p["size"] * m.sign * np.exp(-(((m.theta_out_rad - p["at"]) / p["wide"]) ** 2))),
    drive("ripple_by_speed", {"size": (0.2, 0.4), "k": (0.3, 0.9)},
          lambda m, p: p["size"] * m.speed * np.sin(p["k"] * m.theta_in_rad)),
)  # fmt: skip
"""Laws of a drive with one encoder, torque of the motor on the output side."""

LATER_DRIVE = (
    drive("cubed_drag", {"size": (0.1, 0.2)}, lambda m, p: p["size"] * m.speed**3),
    drive("friction_in_a_sector", {"size": (0.4, 0.7), "at": (-0.5, 0.5)},
          lambda m, p: p["size"] * m.sign * (m.theta_out_rad > p["at"])),
    drive("ripple_by_load", {"size": (0.3, 0.5), "k": (0.3, 0.9), "turn": (0.0, 6.28)},
          lambda m, p: p["size"] * m.acceleration / np.std(m.acceleration)
          * np.sin(p["k"] * m.theta_in_rad + p["turn"])),
    drive("warming_offset", {"size": (0.3, 0.6), "per_K": (0.05, 0.1)},
          lambda m, p: p["size"] * m.sign * np.exp(-p["per_K"] * (m.temperature_degC - 25.0)), warms=True),
)  # fmt: skip
"""Further ones, as above."""

LAST_DRIVE = (
    drive("folding_arm", {"size": (0.2, 0.4), "turn": (0.0, 6.28)},
          lambda m, p: p["size"] * m.acceleration / np.std(m.acceleration) * np.cos(m.theta_out_rad + p["turn"])),
    drive("drag_by_place", {"size": (0.3, 0.5), "k": (1.0, 5.0)},
          lambda m, p: p["size"] * m.speed / np.std(m.speed) * (1 + np.sin(p["k"] * m.theta_out_rad))),
    drive("swinging_load", {"size": (0.2, 0.4), "k": (1.0, 3.0)},
          lambda m, p: p["size"] * m.speed**2 / np.var(m.speed) * np.sin(p["k"] * m.theta_out_rad)),
    drive("rising_friction", {"size": (0.3, 0.6)}, lambda m, p: p["size"] * m.sign * m.time_s / 20.0),
    drive("cold_ripple", {"size": (0.4, 0.7), "k": (0.3, 0.9), "per_K": (0.03, 0.06)},
          lambda m, p: p["size"] * np.sin(p["k"] * m.theta_in_rad)
          * np.exp(-p["per_K"] * (m.temperature_degC - 25.0)), warms=True),
    drive("turning_crank", {"size": (0.2, 0.4)},  # its inertia varies over the turn
          lambda m, p: p["size"] / np.std(m.acceleration)
          * (np.cos(2 * m.theta_out_rad) * m.acceleration - np.sin(2 * m.theta_out_rad) * m.speed**2)),
    drive("dragging_magnet", {"size": (0.5, 0.9), "at": (0.2, 0.5)},
          lambda m, p: p["size"] * m.speed / p["at"] / (1 + (m.speed / p["at"]) ** 2)),
)  # fmt: skip
"""Further ones, as the last above."""
