"""Further laws that no catalogue lists, in two draws, each written before the search was run on any of it.

They go wide rather than deep: every kind of factor with every axis, entering as torque, load, friction, stiffness and
angle error. The first draw was run once before anything was mended, the second only after.
"""

from __future__ import annotations

from math import copysign, cos, exp, sin, sqrt, tanh

import numpy as np
from numpy.random import Generator
from outside_laws import EDGE_RAD, OUTPUT_RAD_S, TWIST_RAD_S, drive, of_load, of_spring, torsion

from edge_daemon.records import Array
from edge_daemon.rig.drive_truth import REVERSAL_WIDTH_RAD_S
from edge_daemon.rig.motion import MotorCourse
from edge_daemon.rig.plant import Influence, Joint
from edge_daemon.rig.truths import Scale, Truth

RUN_S = 20.0
"""of a recording, by which a drift in time is measured"""
TURN_RAD = 2 * np.pi


def wave_of_angle(name: str, meaning: str, low: float, high: float, of_output: bool) -> Truth:
    """An angle error of a free order of the motor or of the output."""

    def draw(rng: Generator, scale: Scale, joint: Joint) -> dict[str, float]:
        size = rng.uniform(0.5, 0.9) * scale.twist_rad
        return {"size": size, "k": rng.uniform(low, high), "turn": rng.uniform(0.0, TURN_RAD)}

    def build(p: dict[str, float], joint: Joint) -> Influence:
        def error(motor: MotorCourse) -> MotorCourse:
            k, at = p["k"], p["k"] * motor.angle + p["turn"]
            bend = k * motor.acceleration * np.cos(at) - (k * motor.speed) ** 2 * np.sin(at)
            return MotorCourse(p["size"] * np.sin(at), p["size"] * k * motor.speed * np.cos(at), p["size"] * bend)

        return Influence(tooth=error) if of_output else Influence(angle=error)

    return Truth(name, meaning, draw, build)  # type: ignore[arg-type]


FIRST_TORSION = (
    torsion("soft_start_spring", "a spring with the root of the twist", of_load, {"size": (0.2, 0.4)},
            lambda i, p, j: p["size"] * copysign(sqrt(abs(i.phi) / p["twist"]), i.phi)),
    torsion("limited_by_reciprocal", "output drag that ends at a torque as speed over one plus speed", of_load,
            {"size": (0.5, 0.8), "at": (0.2, 0.6)},
            lambda i, p, j: -p["size"] * i.speed / (p["at"] * p["speed"] + abs(i.speed))),
    torsion("rubs_from_then_on", "dry output friction that grows from a moment on", of_load,
            {"size": (0.4, 0.7), "from": (6.0, 14.0)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) * max(i.time_s - p["from"], 0.0) / 10.0),
    torsion("mesh_of_one_flank", "an order of the motor in one direction of load", of_load,
            {"size": (0.5, 0.8), "k": (1.2, 4.4), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * max(i.phi, 0.0) / p["twist"] * sin(p["k"] * i.motor + p["turn"])),
    torsion("sprung_latch", "a load that turns round at one place", of_load,
            {"size": (0.4, 0.7), "at": (-0.1, 0.15), "wide": (0.02, 0.06)},
            lambda i, p, j: -p["size"] * tanh((i.angle - p["at"]) / p["wide"])),
    torsion("souring_grease", "damping of the twist that grows in time", of_load, {"size": (0.4, 0.7)},
            lambda i, p, j: p["size"] * i.dphi / p["rate"] * i.time_s / RUN_S),
    torsion("cold_mesh", "an order of the motor that warms away", of_load,
            {"size": (0.5, 0.8), "k": (0.4, 3.6), "turn": (0.0, 6.28), "per_K": (0.03, 0.08)},
            lambda i, p, j: -p["size"] * sin(p["k"] * i.motor + p["turn"]) * exp(-p["per_K"] * i.warmer_K),
            warms=True),
    torsion("stiff_when_fast", "stiffness with the size of the output speed", of_spring, {"size": (0.15, 0.3)},
            lambda i, p, j: p["size"] * i.phi * abs(i.speed) / p["speed"]),
    torsion("crooked_bearing", "dry friction of the twist, modulated once per motor turn", of_load,
            {"size": (0.25, 0.4), "share": (0.5, 0.9), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * tanh(i.dphi / TWIST_RAD_S)
            * (1 + p["share"] * sin(i.motor + p["turn"])), True),
    torsion("root_of_rate", "damping with the root of the twist rate", of_load, {"size": (0.25, 0.4)},
            lambda i, p, j: p["size"] * copysign(sqrt(abs(i.dphi) / p["rate"]), i.dphi), True),
    torsion("dying_hum", "a torque of one frequency that dies away", of_load,
            {"size": (0.6, 0.9), "Hz": (3.0, 20.0), "after": (5.0, 12.0)},
            lambda i, p, j: -p["size"] * sin(TURN_RAD * p["Hz"] * i.time_s) * exp(-i.time_s / p["after"])),
    torsion("periodic_spring", "a spring that gives way and comes again", of_load,
            {"size": (0.3, 0.6), "at": (0.3, 0.7)}, lambda i, p, j: p["size"] * sin(i.phi / (p["at"] * p["twist"]))),
    wave_of_angle("odd_wave_of_motor", "an angle error of an order that is no whole number", 1.2, 3.7, False),
)  # fmt: skip
FIRST_DRIVE = (
    drive("soft_limited_drag", {"size": (0.4, 0.7), "at": (0.2, 0.6)},
          lambda m, p: p["size"] * np.tanh(m.speed / p["at"])),
    drive("ripple_in_time", {"size": (0.3, 0.6), "k": (0.3, 0.9)},
          lambda m, p: p["size"] * np.sin(p["k"] * m.theta_in_rad) * m.time_s / RUN_S),
    drive("one_way_drag", {"size": (0.3, 0.6)}, lambda m, p: p["size"] * np.maximum(m.speed, 0) / np.std(m.speed)),
    drive("friction_of_half_a_turn", {"size": (0.3, 0.5), "turn": (0.0, 6.28)},
          lambda m, p: p["size"] * m.sign * (1 + np.sin(m.theta_out_rad + p["turn"]))),
    drive("square_of_load", {"size": (0.1, 0.2)},
          lambda m, p: p["size"] * m.sign * m.acceleration**2 / np.var(m.acceleration)),
    drive("latch", {"size": (0.4, 0.7), "at": (-0.5, 0.5), "wide": (0.05, 0.2)},
          lambda m, p: p["size"] * np.tanh((m.theta_out_rad - p["at"]) / p["wide"])),
    drive("hum", {"size": (0.3, 0.6), "Hz": (2.0, 9.0)},
          lambda m, p: p["size"] * np.sin(TURN_RAD * p["Hz"] * m.time_s)),
)  # fmt: skip

SECOND_TORSION = (
    torsion("exponential_spring", "a spring that stiffens exponentially one way", of_load,
            {"size": (0.1, 0.2), "at": (0.8, 1.4)},
            lambda i, p, j: p["size"] * (exp(min(i.phi / (p["at"] * p["twist"]), 6.0)) - 1)),
    torsion("drag_by_flank", "viscous output friction in one direction of load", of_load, {"size": (0.4, 0.7)},
            lambda i, p, j: -p["size"] * i.speed / p["speed"] * max(i.phi, 0.0) / p["twist"]),
    torsion("bump_of_load", "a load at one place", of_load,
            {"size": (0.5, 0.9), "at": (-0.1, 0.15), "wide": (0.03, 0.08)},
            lambda i, p, j: -p["size"] * exp(-(((i.angle - p["at"]) / p["wide"]) ** 2))),
    torsion("fast_mesh", "an order of the output that grows with the size of speed", of_load,
            {"size": (0.4, 0.7), "k": (5.0, 15.0), "turn": (0.0, 6.28)},
            lambda i, p, j: -p["size"] * abs(i.speed) / p["speed"] * sin(p["k"] * i.angle + p["turn"])),
    torsion("worn_in_friction", "dry output friction that falls as one over time", of_load,
            {"size": (0.5, 0.9), "after": (2.0, 6.0)},
            lambda i, p, j: -p["size"] * tanh(i.speed / OUTPUT_RAD_S) / (1 + abs(i.time_s) / p["after"])),
    torsion("cold_twist_friction", "dry friction of the twist that warms away", of_load,
            {"size": (0.4, 0.6), "per_K": (0.04, 0.1)},
            lambda i, p, j: p["size"] * tanh(i.dphi / TWIST_RAD_S) * exp(-p["per_K"] * i.warmer_K), True,
            warms=True),
    torsion("friction_of_two_lobes", "dry friction of the twist, stronger at two places of the output's turn", of_load,
            {"size": (0.3, 0.45), "turn": (0.0, 6.28)},
            lambda i, p, j: p["size"] * tanh(i.dphi / TWIST_RAD_S) * (1 + 0.7 * cos(12 * i.angle + p["turn"])), True),
    torsion("loaded_twist_friction", "dry friction of the twist with the square of the twist", of_load,
            {"size": (0.15, 0.3)},
            lambda i, p, j: p["size"] * tanh(i.dphi / TWIST_RAD_S) * min((i.phi / p["twist"]) ** 2, 4.0), True),
    torsion("damping_in_a_sector", "damping of the twist beyond one angle of the output", of_load,
            {"size": (0.5, 0.8), "at": (-0.1, 0.15)},
            lambda i, p, j: p["size"] / 2 * i.dphi / p["rate"] * (1 + tanh((i.angle - p["at"]) / EDGE_RAD))),
    torsion("wave_of_speed_by_place", "a wave along the output times its speed", of_load,
            {"size": (0.4, 0.7), "k": (4.0, 12.0)},
            lambda i, p, j: -p["size"] * i.speed / p["speed"] * cos(p["k"] * i.angle)),
    torsion("softening_with_heat_and_load", "a cubic spring that softens exponentially with heat", of_load,
            {"size": (0.15, 0.3), "per_K": (0.03, 0.08)},
            lambda i, p, j: p["size"] * (i.phi / p["twist"]) ** 3 * exp(-p["per_K"] * i.warmer_K), warms=True),
    torsion("settling_load", "a constant load that settles", of_load, {"size": (0.6, 0.9), "after": (4.0, 10.0)},
            lambda i, p, j: -p["size"] * exp(-i.time_s / p["after"])),
    wave_of_angle("odd_wave_of_output", "an angle error of a free order of the output", 11.0, 40.0, True),
)  # fmt: skip


def _sign(speed: Array) -> Array:
    return np.asarray(np.tanh(speed / REVERSAL_WIDTH_RAD_S))


SECOND_DRIVE = (
    drive("warm_root_drag", {"size": (0.5, 0.8), "per_K": (0.03, 0.08)},
          lambda m, p: p["size"] * m.sign * np.sqrt(np.abs(m.speed) / np.std(m.speed))
          * np.exp(-p["per_K"] * (m.temperature_degC - 25.0)), warms=True),
    drive("ripple_of_both_angles", {"size": (0.4, 0.7), "k": (0.3, 0.9), "n": (1.0, 5.0)},
          lambda m, p: p["size"] * np.sin(p["k"] * m.theta_in_rad) * np.cos(p["n"] * m.theta_out_rad)),
    drive("friction_by_reciprocal", {"size": (0.5, 0.9), "at": (0.1, 0.4)},
          lambda m, p: p["size"] * _sign(m.speed) / (1 + np.abs(m.speed) / p["at"])),
    drive("cube_of_angle", {"size": (0.05, 0.15)}, lambda m, p: p["size"] * m.theta_out_rad**3),
    drive("growing_inertia", {"size": (0.2, 0.4)},
          lambda m, p: p["size"] * m.acceleration / np.std(m.acceleration) * m.time_s / RUN_S),
    drive("dying_hum", {"size": (0.5, 0.9), "Hz": (2.0, 9.0), "after": (5.0, 12.0)},
          lambda m, p: p["size"] * np.sin(TURN_RAD * p["Hz"] * m.time_s) * np.exp(-m.time_s / p["after"])),
    drive("ripple_of_load_one_way", {"size": (0.4, 0.7), "k": (0.3, 0.9)},
          lambda m, p: p["size"] * np.maximum(m.acceleration, 0) / np.std(m.acceleration)
          * np.sin(p["k"] * m.theta_in_rad)),
)  # fmt: skip
