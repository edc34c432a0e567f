"""The torsion truth: motor angle prescribed, twist and output angle integrated.

    J * alpha_out = K * phi + B * dphi + (further torques) - (loads)
    phi = theta_in / R + e(theta_in) - theta_out

with the twist as state: `phi'' = u'' - alpha_out`, `u = theta_in / R + e`. The rule is the implicit midpoint rule
(Hairer, Lubich, Wanner 2006, "Geometric Numerical Integration", II.1): second order, adds no damping of its own, and
stable for the steep friction characteristics. At 8 kHz its stiffness error is (omega*h)^2/12: 2e-5 at 20 Hz. Each step
solves one scalar equation for the twist rate at the middle of the step, by Newton's method inside a bracket.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from edge_daemon.records import Array
from edge_daemon.rig.motion import MotorCourse

SUBSTEP_S = 1.25e-4
"""8 kHz: 23 steps per period of the fastest resonance in use (350 Hz)"""
RATE_TOLERANCE_RAD_S = 1e-5
"""Newton step after which the twist rate counts as solved: what is left is its square over the reversal width, 1e-7,
where the rate itself is around 1e-2"""
MOST_ITERATIONS = 25


class TwistTorque(Protocol):
    """A torque that must be evaluated step by step.

    `at(phi, dphi, speed, angle)` -> torque on the output [N m] and its derivative to `dphi` (0 if small); `keep`
    is called once per finished step, for those with memory.
    """

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]: ...

    def keep(self, dphi: float) -> None: ...


@dataclass(frozen=True, slots=True)
class Influence:
    """How one effect enters the truth; only what it touches is given. Arrays are (n,)."""

    angle: Callable[[MotorCourse], MotorCourse] | None = None
    """motor course -> additive angle e [rad] with its two time derivatives"""
    tooth: Callable[[MotorCourse], MotorCourse] | None = None
    """the same of the output's course: teeth pass as the output turns"""
    stiffness: Callable[[Array, Array], Array] | None = None
    """(theta_in [rad], temperature [degC]) -> relative change of the stiffness"""
    damping: Callable[[Array], Array] | None = None
    """temperature [degC] -> additional damping [N m s/rad]"""
    torque: Callable[[Array, Array], Array] | None = None
    """(time [s], theta_in [rad]) -> additional torque on the output [N m]"""
    twist: TwistTorque | None = None
    load: bool = False
    """its torque acts on the output from outside, so that the gear has to carry it"""
    teeth: Callable[[float, float, float], tuple[float, float]] | None = None
    """(torque [N m] that spring, damper and the gear's other friction carry, its derivative to `dphi`, `dphi`) -> what
    the teeth add to what passes them, and its derivative to `dphi`"""
    inertia: float = 1.0
    """factor on the output inertia"""
    eccentricity: tuple[float, float] = (0.0, 0.0)
    """sine and cosine amplitude [rad] of an error once per output turn of the output encoder"""
    skew_s: float = 0.0
    """the output encoder is read this much later than its time stamp says"""


@dataclass(frozen=True, slots=True)
class Joint:
    """What every drive has. SI units."""

    inertia_kg_m2: float
    stiffness_Nm_per_rad: float
    damping_Nms_per_rad: float
    ratio: float


@dataclass(slots=True)
class Plant:
    """The state of one drive between two stretches of time."""

    joint: Joint
    influences: Sequence[Influence] = ()
    phi_rad: float = 0.0
    dphi_rad_s: float = 0.0
    _guess: tuple[float, float] = field(default=(0.0, 0.0))
    stiffness_scale: float = 1.0
    """wear: a live rig lowers it"""
    behind: MotorCourse | None = None
    """how far the output stays behind a rigid gear, at the instants that are asked for; None: not at all"""

    def input_angle(self, motor: MotorCourse) -> MotorCourse:
        """The motor's course seen from the output, kinematic error included: u, u', u''."""
        ratio = self.joint.ratio
        angle, speed, acceleration = (part / ratio for part in motor)
        late = self.behind or (0.0, 0.0, 0.0)
        output = MotorCourse(angle - late[0], speed - late[1], acceleration - late[2])
        for influence in self.influences:
            for error, course in ((influence.angle, motor), (influence.tooth, output)):
                if error:
                    e = error(course)
                    angle, speed, acceleration = angle + e.angle, speed + e.speed, acceleration + e.acceleration
        return MotorCourse(angle, speed, acceleration)

    def lever(self, theta_in_rad: Array) -> Array:
        """(n,) output angle per motor angle: 1 / ratio and what the kinematic error makes of it there."""
        still = np.zeros_like(theta_in_rad)
        return self.input_angle(MotorCourse(theta_in_rad, still + 1.0, still)).speed

    def carried(self, time_s: Array, twist: tuple[Array, Array, Array], motor: MotorCourse) -> Array:
        """(n,) torque through the gear [N m]: what accelerates the output, and its loads.

        `twist`: with its first and second derivative, (n,) each.
        """
        u, (phi, dphi, ddphi) = self.input_angle(motor), twist
        inertia = self.joint.inertia_kg_m2 * float(np.prod([i.inertia for i in self.influences]))
        total = inertia * (u.acceleration - ddphi)
        for influence in (row for row in self.influences if row.load):
            if influence.torque:
                total = total + influence.torque(time_s, motor.angle)
            if influence.twist:
                rows = zip(*(x.tolist() for x in (phi, dphi, u.speed - dphi, u.angle - phi)), strict=True)
                total = total - np.array([influence.twist.at(*row)[0] for row in rows])
        return np.asarray(total)

    def run(self, time_s: Array, motor: MotorCourse, temperature_degC: Array) -> tuple[Array, Array]:
        """Twist [rad] and twist rate [rad/s], (n,) each, at the *end* of each substep; what is given, at its middle."""
        u = self.input_angle(motor)
        stiffness, damping = self._coefficients(motor.angle, temperature_degC)
        joint = self.joint
        inertia = joint.inertia_kg_m2 * float(np.prod([i.inertia for i in self.influences]))
        push = inertia * u.acceleration
        for influence in self.influences:
            if influence.torque:
                push = push - influence.torque(time_s, motor.angle)
        drive = _Drive(2 * inertia / SUBSTEP_S, push, stiffness, damping)
        further = any(i.twist or i.teeth for i in self.influences)
        return self._nonlinear(drive, u) if further else self._linear(drive)

    def _coefficients(self, theta_in_rad: Array, temperature_degC: Array) -> tuple[Array, Array]:
        factor = np.full(len(theta_in_rad), self.stiffness_scale)
        damping = np.full(len(theta_in_rad), self.joint.damping_Nms_per_rad)
        for influence in self.influences:
            if influence.stiffness:
                factor += influence.stiffness(theta_in_rad, temperature_degC)
            if influence.damping:
                damping += influence.damping(temperature_degC)
        return self.joint.stiffness_Nm_per_rad * factor, damping

    def _linear(self, drive: _Drive) -> tuple[Array, Array]:
        half = SUBSTEP_S / 2
        phi, dphi, double_mass = self.phi_rad, self.dphi_rad_s, drive.double_mass
        twists, rates = [], []
        gains = (double_mass + drive.damping + half * drive.stiffness).tolist()
        for push, k, gain in zip(drive.push.tolist(), drive.stiffness.tolist(), gains, strict=True):
            middle = (double_mass * dphi - k * phi + push) / gain
            phi += SUBSTEP_S * middle
            dphi = 2 * middle - dphi
            twists.append(phi)
            rates.append(dphi)
        self.phi_rad, self.dphi_rad_s = phi, dphi
        return np.array(twists), np.array(rates)

    def _nonlinear(self, drive: _Drive, u: MotorCourse) -> tuple[Array, Array]:
        evaluate = _further(self.influences)
        torques = [i.twist for i in self.influences if i.twist]
        half = SUBSTEP_S / 2
        phi, dphi, double_mass = self.phi_rad, self.dphi_rad_s, drive.double_mass
        last, before = self._guess
        twists, rates = [], []
        gains = (double_mass + drive.damping + half * drive.stiffness).tolist()
        columns = (drive.push.tolist(), drive.stiffness.tolist(), gains, u.speed.tolist(), u.angle.tolist())
        for push, k, gain, speed, angle in zip(*columns, strict=True):
            bent, turn = k * phi, gain - double_mass
            known = double_mass * dphi - bent + push
            middle = 2 * last - before
            torque, slope = evaluate(phi, middle, speed, angle, bent, turn)
            step = (gain * middle + torque - known) / (gain + slope)
            middle -= step
            if step > RATE_TOLERANCE_RAD_S or step < -RATE_TOLERANCE_RAD_S:
                middle = _solved(evaluate, middle, known, gain, (phi, speed, angle, bent, turn))
            for part in torques:
                part.keep(middle)
            before, last = last, middle
            phi += SUBSTEP_S * middle
            dphi = 2 * middle - dphi
            twists.append(phi)
            rates.append(dphi)
        self.phi_rad, self.dphi_rad_s, self._guess = phi, dphi, (last, before)
        return np.array(twists), np.array(rates)


def off_centre(angle_rad: Array, influences: Sequence[Influence]) -> Array:
    """(n,) what an output encoder with the influences' eccentricity says at the true angles."""
    error = np.zeros_like(angle_rad)
    for influence in influences:
        sine, cosine = influence.eccentricity
        error += sine * np.sin(angle_rad) + cosine * np.cos(angle_rad)
    return np.asarray(angle_rad + error)


@dataclass(frozen=True, slots=True)
class _Drive:
    """What the step loop needs: twice the inertia over the step, and (n,) arrays at the middle of each step."""

    double_mass: float
    push: Array
    stiffness: Array
    damping: Array


Evaluate = Callable[[float, float, float, float, float, float], tuple[float, float]]


def _further(influences: Sequence[Influence]) -> Evaluate:
    """All further torques at the middle of a step, and their derivative to the twist rate: those of the gear, what its
    teeth make of all that they pass on, and the loads beyond."""
    gear, loads = ([i.twist.at for i in influences if i.twist and i.load == outside] for outside in (False, True))
    teeth = next((i.teeth for i in influences if i.teeth), None)

    def evaluate(phi: float, dphi: float, speed: float, angle: float, bent: float, turn: float) -> tuple[float, float]:
        middle = phi + 0.5 * SUBSTEP_S * dphi, dphi, speed - dphi, angle - phi
        torque, slope = _summed(gear, *middle)
        if teeth:
            own, own_slope = teeth(bent + turn * dphi + torque, turn + slope, dphi)
            torque, slope = torque + own, slope + own_slope
        if loads:
            outer, outer_slope = _summed(loads, *middle)
            torque, slope = torque + outer, slope + outer_slope
        return torque, slope

    return evaluate


def _summed(
    parts: Sequence[Callable[..., tuple[float, float]]], phi: float, dphi: float, speed: float, angle: float
) -> tuple[float, float]:
    total = total_slope = 0.0
    for part in parts:
        torque, slope = part(phi, dphi, speed, angle)
        total += torque
        total_slope += slope
    return total, total_slope


def _solved(
    evaluate: Evaluate, middle: float, known: float, gain: float, at: tuple[float, float, float, float, float]
) -> float:
    """The twist rate that balances the step: Newton, halving the bracket when it would leave it."""
    low, high = float("-inf"), float("inf")
    for _ in range(MOST_ITERATIONS):
        torque, slope = evaluate(at[0], middle, *at[1:])
        excess = gain * middle + torque - known
        if excess > 0:
            high = middle
        else:
            low = middle
        step = excess / (gain + slope)
        following = middle - step
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - middle) < RATE_TOLERANCE_RAD_S:
            return following
        middle = following
    return middle
