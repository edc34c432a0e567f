"""The integrator against analytic solutions and against scipy's solver on equations written down a second time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from edge_daemon.gear import steps
from edge_daemon.gear.torques import law
from edge_daemon.rig.motion import MotorCourse, MotorMotion, custom, tone
from edge_daemon.rig.plant import SUBSTEP_S, Influence, Joint, Plant, stages

STANDSTILL = custom([1.0], [0.0])
JOINT = Joint(inertia_kg_m2=0.1, stiffness_Nm_per_rad=3e4, damping_Nms_per_rad=5.0, ratio=100.0)


def run(plant: Plant, motion: MotorMotion, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Time at the end of each substep, and the twist there."""
    n = round(seconds / SUBSTEP_S)
    inside = stages(0, n)
    twist, _ = plant.run(inside, motion.course(inside), np.full(3 * n, 25.0))
    return (np.arange(n) + 1) * SUBSTEP_S, twist


@pytest.mark.parametrize(("inertia", "stiffness"), [(0.2, 1e4 * 8), (0.1, 3e4), (0.05, 1e5), (0.05, 2.4e5)])
def test_free_vibration_has_the_analytic_frequency_and_damping(inertia: float, stiffness: float) -> None:
    damping = 0.04 * 2 * math.sqrt(stiffness * inertia)
    plant = Plant(Joint(inertia, stiffness, damping, 100.0), phi_rad=1e-4)
    time_s, twist = run(plant, STANDSTILL, 0.2)
    decay = damping / (2 * inertia)
    omega = math.sqrt(stiffness / inertia - decay**2)
    crossings = np.flatnonzero(np.diff(np.sign(twist)) != 0)
    exact = [time_s[i] + SUBSTEP_S * twist[i] / (twist[i] - twist[i + 1]) for i in crossings]
    measured = math.pi * (len(exact) - 1) / (exact[-1] - exact[0])
    assert measured == pytest.approx(omega, rel=1.1 * (omega * SUBSTEP_S) ** 2 / 12 + 1e-4)
    peaks = [np.abs(twist[a:b]).max() for a, b in zip(crossings[:-1] + 1, crossings[1:] + 1, strict=True)]
    decrement = -np.polyfit(np.arange(len(peaks)), np.log(peaks), 1)[0]
    assert decrement == pytest.approx(decay * math.pi / omega, rel=0.02)


@pytest.mark.parametrize("frequency_hz", [1.0, 5.0, 20.0, 30.0])
def test_forced_twist_equals_the_transfer_function(frequency_hz: float) -> None:
    motion = custom([frequency_hz], [200.0])
    time_s, twist = run(Plant(JOINT), motion, 2.0)
    omega = 2 * math.pi * frequency_hz
    mass, k, b = JOINT.inertia_kg_m2, JOINT.stiffness_Nm_per_rad, JOINT.damping_Nms_per_rad
    swing = 200.0 / omega / JOINT.ratio
    expected = -swing * mass * omega**2 / complex(k - mass * omega**2, b * omega)
    settled = time_s > 1.0
    columns = np.column_stack((np.sin(omega * time_s), np.cos(omega * time_s)))[settled]
    (sine, cosine), *_ = np.linalg.lstsq(columns, twist[settled], rcond=None)
    assert abs(complex(sine, cosine) - expected) < 2e-4 * abs(expected)


def motor() -> MotorMotion:
    return MotorMotion("test", (tone(6.3, 90.0, 0.3), tone(14.1, 60.0, 1.9)))


Law = Callable[[float, float, float, float, np.ndarray], tuple[float, list[float]]]
"""(phi, dphi, speed_out, theta_out, memory) -> torque, rates of the memory"""
SIGN_WIDTH = 1e-3


def coulomb(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    return 1.3 * math.tanh(dphi / SIGN_WIDTH), []


def stribeck(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    return (0.8 + 0.9 * math.exp(-((dphi / 0.02) ** 2))) * math.tanh(dphi / SIGN_WIDTH), []


def load_friction(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    """mu |tau| sgn, tau being all that passes the teeth, this friction included: by repetition."""
    carried = JOINT.stiffness_Nm_per_rad * phi + JOINT.damping_Nms_per_rad * dphi
    friction = 0.0
    for _ in range(20):
        friction = 0.25 * abs(carried + friction) * math.tanh(dphi / SIGN_WIDTH)
    return friction, []


def dahl(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    return z[0], [4e4 * (dphi - abs(dphi) * z[0] / 1.2)]


def bouc_wen(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    rate = dphi - 0.6 * abs(dphi) * z[0] - 0.4 * dphi * abs(z[0])  # n = 1, both sides times the knee
    return 3.0 * z[0], [rate / 6e-5]


def lugre(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    g = 1.0 + 0.5 * math.exp(-((dphi / 0.01) ** 2))
    rate = dphi - 4e4 * abs(dphi) / g * z[0]
    return 4e4 * z[0] + 0.3 * rate, [rate]


def backlash(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    beyond = math.copysign(max(0.0, abs(phi) - 4e-5), phi)
    return 3e4 * (beyond - phi), []


def polynomial(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    return 1e7 * phi**2 + 1e11 * phi**3, []


def gravity(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    return -4.0 * math.sin(angle + 0.7), []


def output_friction(phi: float, dphi: float, speed: float, angle: float, z: np.ndarray) -> tuple[float, list[float]]:
    return -1.5 * speed - 0.9 * math.tanh(speed / 1e-2), []


LAWS: dict[str, tuple[Law, Influence]] = {
    "coulomb": (coulomb, Influence(twist=law(steps.COULOMB, 1.3))),
    "stribeck": (stribeck, Influence(twist=law(steps.STRIBECK, 0.8, 1.7, 0.02))),
    "load_friction": (load_friction, Influence(tooth_friction=0.25)),
    "bouc_wen": (bouc_wen, Influence(twist=law(steps.BOUC_WEN, 3.0, 6e-5, 0.6, 1.0))),
    "lugre": (lugre, Influence(twist=law(steps.LUGRE, 1.0, 1.5, 0.01, 4e4, 0.3))),
    "backlash": (backlash, Influence(twist=law(steps.DEAD_ZONE, 4e-5, 3e4))),
    "polynomial": (polynomial, Influence(twist=law(steps.POLYNOMIAL, 1e7, 1e11))),
    "gravity": (gravity, Influence(load=True, twist=law(steps.GRAVITY, 4.0, 0.7))),
    "output_friction": (output_friction, Influence(load=True, twist=law(steps.OUTPUT_FRICTION, 1.5, 0.9))),
    "dahl": (dahl, Influence(twist=law(steps.DAHL, 1.2, 4e4))),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_each_torque_law_integrates_to_what_an_independent_solver_finds(name: str) -> None:
    by_hand, part = LAWS[name]
    motion, seconds = motor(), 0.5
    time_s, twist = run(Plant(JOINT, [part]), motion, seconds)

    def rates(t: float, y: np.ndarray) -> list[float]:
        course = motion.course(np.array([t]))
        u, u1, u2 = (float(x[0]) / JOINT.ratio for x in course)
        torque, memory = by_hand(y[0], y[1], u1 - y[1], u - y[0], y[2:])
        alpha = (JOINT.stiffness_Nm_per_rad * y[0] + JOINT.damping_Nms_per_rad * y[1] + torque) / JOINT.inertia_kg_m2
        return [y[1], u2 - alpha, *memory]

    start = [0.0] * (3 if name in ("bouc_wen", "lugre", "dahl") else 2)
    found = solve_ivp(rates, (0, seconds), start, "LSODA", t_eval=time_s[::8], rtol=1e-9, atol=1e-14, max_step=2e-4)
    error = twist[::8] - found.y[0]
    moving = time_s[::8] > 0.1  # the start from rest is a blow that no motion of a recording has
    assert np.sqrt(np.mean(error[moving] ** 2)) < 1e-4 * np.sqrt(np.mean(found.y[0] ** 2))
    assert np.sqrt(np.mean(error**2)) < 1e-3 * np.sqrt(np.mean(found.y[0] ** 2))


def test_maxwell_slip_follows_masings_rule() -> None:
    """Loading from rest gives the virgin curve f(x); a reversal at x0 gives f(x0) - 2 f((x0 - x)/2) (Masing 1926)."""
    part = law(steps.MAXWELL_SLIP, 1e4, 5e-5, 2e4, 1e-4)

    def virgin(x: float) -> float:
        return 1e4 * min(x, 5e-5) + 2e4 * min(x, 1e-4)

    speed = 1e-3
    step = speed * SUBSTEP_S
    z = part.start
    for _ in range(round(1.5e-4 / step)):
        z = part.grown(z, SUBSTEP_S, speed)
    assert part.at(z, SUBSTEP_S, 0, 0, 0, 0)[0] == pytest.approx(virgin(1.5e-4))
    for back in range(1, round(2.5e-4 / step)):
        z = part.grown(z, SUBSTEP_S, -speed)
        assert part.at(z, SUBSTEP_S, 0, 0, 0, 0)[0] == pytest.approx(
            virgin(1.5e-4) - 2 * virgin(back * step / 2), abs=1e-9
        )


def test_kinematic_error_moves_the_output_of_a_slow_gear_by_itself() -> None:
    size = 1.4e-4

    def angle(course: MotorCourse) -> MotorCourse:
        sine, cosine = np.sin(2 * course.angle), np.cos(2 * course.angle)
        return MotorCourse(size * sine, 2 * size * course.speed * cosine, -4 * size * course.speed**2 * sine)

    plant = Plant(JOINT, [Influence(angle=angle)])
    crawl = MotorMotion("crawl", (lambda t: MotorCourse(3.0 * t, np.full_like(t, 3.0), np.zeros_like(t)),))
    time_s, twist = run(plant, crawl, 3.0)
    course = crawl.course(time_s)
    theta_out = plant.input_angle(course).angle - twist
    error = theta_out - course.angle / JOINT.ratio
    settled = time_s > 1.0
    assert np.abs(error - size * np.sin(2 * course.angle))[settled].max() < 0.01 * size


def test_no_energy_appears_in_a_conservative_joint() -> None:
    joint = Joint(0.1, 3e4, 0.0, 100.0)
    plant = Plant(joint, phi_rad=2e-4)
    for _ in range(20):
        run(plant, STANDSTILL, 0.05)
        energy = 0.5 * joint.stiffness_Nm_per_rad * plant.phi_rad**2 + 0.5 * joint.inertia_kg_m2 * plant.dphi_rad_s**2
        assert energy == pytest.approx(0.5 * 3e4 * 4e-8, rel=1e-9)


def test_a_stretch_may_be_cut_anywhere() -> None:
    motion = motor()
    whole, pieces = (Plant(JOINT, [Influence(twist=law(steps.COULOMB, 1.0))]) for _ in range(2))
    middle = stages(0, 4000)
    heat = np.full(12000, 25.0)
    cuts = [21, 240, 5997]
    at_once, _ = whole.run(middle, motion.course(middle), heat)
    cut = [
        pieces.run(m, motion.course(m), h)[0] for m, h in zip(np.split(middle, cuts), np.split(heat, cuts), strict=True)
    ]
    np.testing.assert_array_equal(np.concatenate(cut), at_once)
