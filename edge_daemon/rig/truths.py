"""The physical effects that the simulated drive can have: one row each, drawn at a believable and material size.

Sizes scale with what the motion does to a plain linear joint (`Scale`), so that an effect changes the torque by some
5 to 40 per cent whatever the motion. Ranges are chosen, not measured, unless a source is given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edge_daemon.gear import steps
from edge_daemon.gear.torques import GearLaw, law
from edge_daemon.records import Array
from edge_daemon.rig.motion import MotorCourse, MotorMotion
from edge_daemon.rig.plant import Influence, Joint
from edge_daemon.rig.simulated import FREE_ORDER, OF_OUTPUT, REFERENCE_DEGC, free_order_of_input

Parameters = Mapping[str, float]
TURN_RAD = 2 * math.pi
HYSTERESIS_ELEMENTS = 4


@dataclass(frozen=True, slots=True)
class Scale:
    """RMS of what a plain linear joint does in this motion."""

    torque_Nm: float
    twist_rad: float
    twist_rate_rad_s: float
    speed_out_rad_s: float
    temperature_rise_K: float
    """how far the temperature strays from the reference in this recording; 15 if it does not"""


def scale_of(joint: Joint, motion: MotorMotion, seconds: float, temperature_rise_K: float) -> Scale:
    """What a rigid joint would do: exact enough far below the resonance."""
    course = motion.course(np.arange(0.0, seconds, 2e-3))
    torque = joint.inertia_kg_m2 * course.acceleration / joint.ratio
    return Scale(
        torque_Nm=rms(torque),
        twist_rad=rms(torque) / joint.stiffness_Nm_per_rad,
        twist_rate_rad_s=rms(np.gradient(torque, 2e-3)) / joint.stiffness_Nm_per_rad,
        speed_out_rad_s=rms(course.speed) / joint.ratio,
        temperature_rise_K=temperature_rise_K,
    )


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


Draw = Callable[[np.random.Generator, Scale, Joint], dict[str, float]]
Build = Callable[[Parameters, Joint], Influence]


@dataclass(frozen=True, slots=True)
class Truth:
    """One effect of the simulated drive."""

    name: str
    meaning: str
    draw: Draw
    build: Build
    warms: bool = False
    """visible only if the temperature changes: the recording then warms up"""


def _polynomial(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    k = joint.stiffness_Nm_per_rad
    return {
        "k1_Nm_per_rad2": rng.uniform(-0.05, 0.05) * k / scale.twist_rad,
        "k2_Nm_per_rad3": rng.uniform(0.04, 0.10) * k / scale.twist_rad**2,
    }


def _piecewise(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    """Catalogues (CSF/CSG) give K2/K1 of 1.3-1.65 and K3/K2 of 1.14-1.2."""
    k2 = rng.uniform(1.35, 1.65)
    return {
        "corner1_rad": rng.uniform(0.5, 0.8) * scale.twist_rad,
        "corner2_rad": rng.uniform(1.5, 1.9) * scale.twist_rad,
        "k2_over_k1": k2,
        "k3_over_k1": k2 * rng.uniform(1.12, 1.2),
    }


def _build_piecewise(p: Parameters, joint: Joint) -> Influence:
    k = joint.stiffness_Nm_per_rad
    rises = (k * (p["k2_over_k1"] - 1.0), k * (p["k3_over_k1"] - p["k2_over_k1"]))
    return Influence(twist=law(steps.PIECEWISE, p["corner1_rad"], p["corner2_rad"], *rises))


def _stribeck(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    level = rng.uniform(0.12, 0.2) * scale.torque_Nm
    return {
        "level_Nm": level,
        "static_Nm": level * rng.uniform(2.0, 2.6),
        "stribeck_rad_s": rng.uniform(0.5, 0.9) * scale.twist_rate_rad_s,
    }


def _build_stribeck(p: Parameters, joint: Joint) -> Influence:
    return Influence(twist=law(steps.STRIBECK, p["level_Nm"], p["static_Nm"], p["stribeck_rad_s"]))


def _lugre(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    level = rng.uniform(0.2, 0.3) * scale.torque_Nm
    return {
        "level_Nm": level,
        "static_Nm": level * rng.uniform(1.2, 1.6),
        "stribeck_rad_s": rng.uniform(0.2, 0.4) * scale.twist_rate_rad_s,
        "bristle_Nm_per_rad": level / (rng.uniform(0.1, 0.2) * scale.twist_rad),
        "bristle_Nms_per_rad": 0.05 * joint.damping_Nms_per_rad,
    }


def _build_lugre(p: Parameters, joint: Joint) -> Influence:
    return Influence(
        twist=law(
            steps.LUGRE,
            p["level_Nm"],
            p["static_Nm"],
            p["stribeck_rad_s"],
            p["bristle_Nm_per_rad"],
            p["bristle_Nms_per_rad"],
        )
    )


def _dahl(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    level = rng.uniform(0.25, 0.4) * scale.torque_Nm
    return {"level_Nm": level, "rest_Nm_per_rad": level / (rng.uniform(0.1, 0.3) * scale.twist_rad)}


def _build_dahl(p: Parameters, joint: Joint) -> Influence:
    return Influence(twist=law(steps.DAHL, p["level_Nm"], p["rest_Nm_per_rad"]))


def _maxwell(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    return {
        "total_Nm": rng.uniform(0.35, 0.55) * scale.torque_Nm,
        "widest_rad": rng.uniform(0.7, 1.1) * scale.twist_rad,
    }


def _build_maxwell(p: Parameters, joint: Joint) -> Influence:
    """Elements slip one after another, at evenly spaced twists, each at the same torque."""
    limits = tuple(p["widest_rad"] * (i + 1) / HYSTERESIS_ELEMENTS for i in range(HYSTERESIS_ELEMENTS))
    each = p["total_Nm"] / HYSTERESIS_ELEMENTS
    return Influence(twist=law(steps.MAXWELL_SLIP, *(x for limit in limits for x in (each / limit, limit))))


def _lopsided(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    taper = rng.uniform(3.0, 8.0) * scale.twist_rad
    return {**_maxwell(rng, scale, joint), "doubled_at_rad": taper if rng.random() < 0.5 else -taper}


def _build_lopsided(p: Parameters, joint: Joint) -> Influence:
    """The springs of the even loop, pressed together the more the further the gear is twisted one way."""
    even = _build_maxwell(p, joint).twist
    assert isinstance(even, GearLaw)
    return Influence(twist=law(steps.LOPSIDED_SLIP, p["doubled_at_rad"], HYSTERESIS_ELEMENTS, *even.numbers))


def _kinematic(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    """Catalogue: 1 arc-min (2.9e-4 rad) peak to peak; twice per wave generator turn above all."""
    second = rng.uniform(0.8e-4, 1.2e-4)
    return {
        "order2_rad": second,
        "order4_rad": second * rng.uniform(0.2, 0.35),
        "order1_rad": second * rng.uniform(0.02, 0.08),
        "phase2_rad": rng.uniform(0, TURN_RAD),
        "phase4_rad": rng.uniform(0, TURN_RAD),
        "phase1_rad": rng.uniform(0, TURN_RAD),
        **FREE_ORDER,
        "free_rad": 0.0,
    }


def _build_kinematic(p: Parameters, joint: Joint) -> Influence:
    orders: list[tuple[float, float, float]] = [(m, p[f"order{m}_rad"], p[f"phase{m}_rad"]) for m in (1, 2, 4)]
    if p["free_angle"] == OF_OUTPUT:
        return Influence(
            angle=_repeating(orders), tooth=_repeating([(p["free_order"], p["free_rad"], p["free_phase_rad"])])
        )
    free = (free_order_of_input(p, joint.ratio), p["free_rad"], p["free_phase_rad"])
    return Influence(angle=_repeating([*orders, free]))


def _repeating(waves: Sequence[tuple[float, float, float]]) -> Callable[[MotorCourse], MotorCourse]:
    """A sum of waves (order per turn, size, phase) of a course, with its two time derivatives."""

    def angle(motor: MotorCourse) -> MotorCourse:
        e, e1, e2 = (np.zeros_like(motor.angle) for _ in range(3))
        for m, size, phase in waves:
            sine, cosine = np.sin(m * motor.angle + phase), np.cos(m * motor.angle + phase)
            e += size * sine
            e1 += size * m * motor.speed * cosine
            e2 += size * m * (motor.acceleration * cosine - m * motor.speed**2 * sine)
        return MotorCourse(e, e1, e2)

    return angle


def _ripple(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    second = rng.uniform(0.25, 0.45) * scale.torque_Nm
    return {
        "order2_Nm": second,
        "order4_Nm": 0.25 * second,
        "phase2_rad": rng.uniform(0, TURN_RAD),
        "phase4_rad": rng.uniform(0, TURN_RAD),
    }


def _build_ripple(p: Parameters, joint: Joint) -> Influence:
    def torque(time_s: Array, theta_in_rad: Array) -> Array:
        second = p["order2_Nm"] * np.sin(2 * theta_in_rad + p["phase2_rad"])
        return np.asarray(second + p["order4_Nm"] * np.sin(4 * theta_in_rad + p["phase4_rad"]))

    return Influence(torque=torque)


def _build_polynomial(p: Parameters, joint: Joint) -> Influence:
    return Influence(twist=law(steps.POLYNOMIAL, p["k1_Nm_per_rad2"], p["k2_Nm_per_rad3"]))


def _build_vibration(p: Parameters, joint: Joint) -> Influence:
    omega = TURN_RAD * p["frequency_hz"]
    return Influence(torque=lambda time_s, theta: p["size_Nm"] * np.sin(omega * time_s + p["phase_rad"]))


def _build_eccentricity(p: Parameters, joint: Joint) -> Influence:
    return Influence(eccentricity=(p["sine_rad"], p["cosine_rad"]))


def _eccentricity(rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    size, phase = rng.uniform(0.6, 1.2) * scale.twist_rad, rng.uniform(0, TURN_RAD)
    return {"sine_rad": size * math.cos(phase), "cosine_rad": size * math.sin(phase)}


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


ROWS = (
    Truth("polynomial_stiffness", "stiffness changes with the twist", _polynomial, _build_polynomial),
    Truth("piecewise_stiffness", "three straight pieces, as catalogues give them", _piecewise, _build_piecewise),
    Truth(
        "coulomb_friction",
        "dry friction on the twist rate",
        lambda rng, s, j: {"level_Nm": rng.uniform(0.22, 0.32) * s.torque_Nm},
        lambda p, j: Influence(twist=law(steps.COULOMB, p["level_Nm"])),
    ),
    Truth("stribeck_friction", "dry friction that falls with the twist rate", _stribeck, _build_stribeck),
    Truth("lugre_friction", "dry friction with bristles", _lugre, _build_lugre),
    Truth("dahl_friction", "dry friction that yields before it slides", _dahl, _build_dahl),
    Truth(
        "load_dependent_friction",
        "dry friction in proportion to the torque that passes the teeth",
        lambda rng, s, j: {"mu": rng.uniform(0.2, 0.35)},
        lambda p, j: Influence(tooth_friction=p["mu"]),
    ),
    Truth(
        "bouc_wen_hysteresis",
        "smooth hysteresis of the flexspline",
        lambda rng, s, j: {
            "level_Nm": rng.uniform(0.4, 0.65) * s.torque_Nm,
            "knee_rad": rng.uniform(0.25, 0.4) * s.twist_rad,
            "beta": rng.uniform(0.55, 0.75),
        },
        lambda p, j: Influence(twist=law(steps.BOUC_WEN, p["level_Nm"], p["knee_rad"], p["beta"], 1.0)),
    ),
    Truth("maxwell_slip_hysteresis", "hysteresis of slipping springs", _maxwell, _build_maxwell),
    Truth("asymmetric_hysteresis", "hysteresis of springs whose grip follows the twist", _lopsided, _build_lopsided),
    Truth(
        "backlash",
        "lost motion at zero torque",
        lambda rng, s, j: {"gap_rad": rng.uniform(0.4, 0.9) * s.twist_rad},
        lambda p, j: Influence(twist=law(steps.DEAD_ZONE, 0.5 * p["gap_rad"], j.stiffness_Nm_per_rad)),
    ),
    Truth("kinematic_error", "angle error that repeats with the wave generator", _kinematic, _build_kinematic),
    Truth("torque_ripple", "torque that repeats with the wave generator", _ripple, _build_ripple),
    Truth(
        "mesh_stiffness",
        "stiffness that repeats with the wave generator",
        lambda rng, s, j: {"relative": rng.uniform(0.2, 0.35), "phase_rad": rng.uniform(0, TURN_RAD)},
        lambda p, j: Influence(stiffness=lambda theta, degC: p["relative"] * np.sin(2 * theta + p["phase_rad"])),
    ),
    Truth(
        "gravity_load",
        "unbalanced mass on the output",
        lambda rng, s, j: {"size_Nm": rng.uniform(0.5, 1.0) * s.torque_Nm, "phase_rad": rng.uniform(0, TURN_RAD)},
        lambda p, j: Influence(load=True, twist=law(steps.GRAVITY, p["size_Nm"], p["phase_rad"])),
    ),
    Truth(
        "constant_load",
        "constant torque on the output",
        lambda rng, s, j: {"load_Nm": _sign(rng) * rng.uniform(0.2, 0.5) * s.torque_Nm},
        lambda p, j: Influence(torque=lambda time_s, theta: np.full(len(time_s), -p["load_Nm"]), load=True),
    ),
    Truth(
        "inertia_error",
        "the output inertia is not the configured one",
        lambda rng, s, j: {"relative": _sign(rng) * rng.uniform(0.1, 0.3)},
        lambda p, j: Influence(inertia=1.0 + p["relative"]),
    ),
    Truth(
        "output_viscous_friction",
        "bearing friction in proportion to the output speed",
        lambda rng, s, j: {"Nms_per_rad": rng.uniform(0.15, 0.35) * s.torque_Nm / s.speed_out_rad_s},
        lambda p, j: Influence(load=True, twist=law(steps.OUTPUT_FRICTION, p["Nms_per_rad"], 0.0)),
    ),
    Truth(
        "output_coulomb_friction",
        "dry bearing friction on the output speed",
        lambda rng, s, j: {"level_Nm": rng.uniform(0.15, 0.35) * s.torque_Nm},
        lambda p, j: Influence(load=True, twist=law(steps.OUTPUT_FRICTION, 0.0, p["level_Nm"])),
    ),
    Truth("encoder_eccentricity", "output encoder off centre", _eccentricity, _build_eccentricity),
    Truth(
        "encoder_skew",
        "the encoders are not read at one instant",
        lambda rng, s, j: {"delay_s": _sign(rng) * rng.uniform(0.15, 0.4) * s.twist_rad / s.speed_out_rad_s},
        lambda p, j: Influence(skew_s=p["delay_s"]),
    ),
    Truth(
        "temperature_stiffness",
        "stiffness changes with the temperature",
        lambda rng, s, j: {"relative_per_K": -rng.uniform(0.15, 0.3) / s.temperature_rise_K},
        lambda p, j: Influence(stiffness=lambda theta, degC: p["relative_per_K"] * (degC - REFERENCE_DEGC)),
        warms=True,
    ),
    Truth(
        "temperature_friction",
        "viscous damping changes with the temperature",
        lambda rng, s, j: {
            "Nms_per_rad_K": rng.uniform(0.2, 0.35) * s.torque_Nm / s.twist_rate_rad_s / s.temperature_rise_K
        },
        lambda p, j: Influence(damping=lambda degC: p["Nms_per_rad_K"] * (degC - REFERENCE_DEGC)),
        warms=True,
    ),
)

OUTSIDE = (
    Truth(
        "outside_speed_wave",
        "a torque periodic in the output speed",
        lambda rng, s, j: {
            "size_Nm": rng.uniform(0.25, 0.4) * s.torque_Nm,
            "period_rad_s": rng.uniform(0.6, 1.0) * s.speed_out_rad_s,
        },
        lambda p, j: Influence(twist=law(steps.SPEED_WAVE, p["size_Nm"], p["period_rad_s"])),
    ),
    Truth(
        "outside_twist_times_angle",
        "a stiffness that depends on where the output stands",
        lambda rng, s, j: {
            "stiffness_Nm_per_rad": rng.uniform(0.25, 0.4) * j.stiffness_Nm_per_rad,
            "order": float(rng.integers(5, 12)),
            "phase_rad": rng.uniform(0, TURN_RAD),
        },
        lambda p, j: Influence(
            twist=law(steps.TWIST_TIMES_ANGLE, p["stiffness_Nm_per_rad"], p["order"], p["phase_rad"])
        ),
    ),
    Truth(
        "outside_vibration",
        "a torque from elsewhere at a frequency of its own",
        lambda rng, s, j: {
            "size_Nm": rng.uniform(0.2, 0.35) * s.torque_Nm,
            "frequency_hz": rng.uniform(24.0, 38.0),
            "phase_rad": rng.uniform(0, TURN_RAD),
        },
        _build_vibration,
    ),
)
"""Effects that no catalogue of gears lists: what a diagnosis must call unexplained."""
DRAWN_OUTSIDE = ("outside_speed_wave", "outside_twist_times_angle", "outside_vibration")
"""Effects that `outside` is drawn from, for ever: one more would change what old seeds draw."""

TRUTHS: dict[str, Truth] = {row.name: row for row in (*ROWS, *OUTSIDE)}
