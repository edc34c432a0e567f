"""The torsion truth: motor angle prescribed, twist and output angle integrated.

    J * alpha_out = K * phi + B * dphi + (further torques) - (loads)
    phi = theta_in / R + e(theta_in) - theta_out

with the twist as state: `phi'' = u'' - alpha_out`, `u = theta_in / R + e`. `steps` holds the rule: fourth order, exact
for the linear part. `tools/bench_effects.py --rig` prints what a recording errs by against one of much finer steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Protocol

import numpy as np

from edge_daemon.gear import steps
from edge_daemon.gear.torques import GearLaw
from edge_daemon.records import Array
from edge_daemon.rig.motion import MotorCourse

SUBSTEP_S = 1.25e-4
"""8 kHz: 23 steps per period of the fastest resonance in use (350 Hz)"""
STAGES = (0.25, 0.5, 0.75)
"""Where in a step the rule asks for what drives the gear."""
TAYLOR_TERMS = 24
"""Of a matrix exponential: enough for steps of a whole period of the resonance."""


def stages(first: int, count: int, step_s: float = SUBSTEP_S) -> Array:
    """(3 count,) instants [s] at which steps `first` and following ask for what drives the gear."""
    return np.asarray((np.arange(first, first + count)[:, None] + np.array(STAGES)).ravel() * step_s)


class TwistTorque(Protocol):
    """A torque that must be evaluated step by step, and may remember some numbers `z`, at first `start`.

    `at` gives the torque on the output [N m] in the middle of a step that begins with `z`, and its derivative to
    `dphi` (0 if small); `grown` what is remembered after it.
    """

    @property
    def start(self) -> tuple[float, ...]: ...

    def at(
        self, z: Sequence[float], step_s: float, phi: float, dphi: float, speed: float, angle: float
    ) -> tuple[float, float]: ...

    def grown(self, z: Sequence[float], step_s: float, dphi: float) -> Sequence[float]: ...


class CodedTorque(TwistTorque, Protocol):
    """One that may also be stepped by machine code of its own, which is handed its `numbers`."""

    @property
    def numbers(self) -> tuple[float, ...]: ...

    def code(self) -> tuple[object, object] | None:
        """Compiled functions (numbers, z, step_s, phi, dphi, speed, angle) -> (torque, slope) and
        (numbers, z, step_s, dphi), which changes z; None where it has none."""


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
    tooth_friction: float = 0.0
    """friction of the teeth over all that passes them"""
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
    _change: float = 0.0
    """of the twist rate over the last step"""
    _memory: list[tuple[Influence, list[float]]] = field(default_factory=list)
    """what each law remembers"""
    stiffness_scale: float = 1.0
    """wear: a live rig lowers it"""
    step_s: float = SUBSTEP_S
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
                z, at = self.remembered(influence), influence.twist.at
                rows = zip(*(x.tolist() for x in (phi, dphi, u.speed - dphi, u.angle - phi)), strict=True)
                total = total - np.array([at(z, self.step_s, *row)[0] for row in rows])
        return np.asarray(total)

    def run(
        self, time_s: Array, motor: MotorCourse, temperature_degC: Array, *, compiled: bool = False
    ) -> tuple[Array, Array]:
        """Twist [rad] and twist rate [rad/s], (n,) each, at the *end* of each substep; what is given, at the (3 n,)
        instants that `stages` tells. `compiled`: worth it for a whole recording."""
        joint, rows = self.joint, [i for i in self.influences if i.twist]
        forcing, inertia = self._forcing(time_s, motor, temperature_degC)
        base = joint.stiffness_Nm_per_rad * self.stiffness_scale, joint.damping_Nms_per_rad
        rules = tuple(_rule(*base, inertia, share * self.step_s) for share in (1.0, 0.5))
        fixed = (*base, sum((i.tooth_friction for i in self.influences), 0.0)), rules, self.step_s
        laws = _Laws([i.twist for i in rows if i.twist], [i.load for i in rows], [self.remembered(i) for i in rows])
        state = [self.phi_rad, self.dphi_rad_s, self._change]
        moved = laws.advance_compiled if compiled and laws.may_be_compiled else laws.advance
        twists, rates, (self.phi_rad, self.dphi_rad_s, self._change) = moved(fixed, forcing, state)
        return twists, rates

    def _forcing(self, time_s: Array, motor: MotorCourse, temperature_degC: Array) -> tuple[Array, float]:
        """(3 n, 5) change of stiffness and of damping, push [N m], output speed and angle of a rigid gear; inertia."""
        u, joint = self.input_angle(motor), self.joint
        inertia = joint.inertia_kg_m2 * float(np.prod([i.inertia for i in self.influences]))
        push, stiffer, damping = inertia * u.acceleration, np.zeros(len(time_s)), np.zeros(len(time_s))
        for influence in self.influences:
            if influence.torque:
                push = push - influence.torque(time_s, motor.angle)
            if influence.stiffness:
                stiffer += joint.stiffness_Nm_per_rad * influence.stiffness(motor.angle, temperature_degC)
            if influence.damping:
                damping += influence.damping(temperature_degC)
        return np.column_stack((stiffer, damping, push, u.speed, u.angle)), inertia

    def remembered(self, influence: Influence) -> list[float]:
        """What the law of an influence remembers; the list itself."""
        for row, z in self._memory:
            if row is influence:
                return z
        self._memory.append((influence, [*influence.twist.start] if influence.twist else []))
        return self._memory[-1][1]


_Moved = tuple[Array, Array, list[float]]
_Fixed = tuple[tuple[float, float, float], tuple[tuple[float, ...], ...], float]
"""K, B and mu of the teeth; rules of a whole step and of its halves; the step [s]"""


@dataclass(frozen=True, slots=True)
class _Laws:
    """Laws, whether each is a load, and what they remember: lists to be stepped as they are, or tables."""

    laws: Sequence[TwistTorque]
    beyond: Sequence[bool]
    memory: Sequence[list[float]]

    @property
    def may_be_compiled(self) -> bool:
        """One law at most may bring its own code."""
        others = [law for law in self.laws if not isinstance(law, GearLaw)]
        return not others or (len(others) == 1 and _code_of(others[0]) is not None)

    def advance(self, fixed: _Fixed, forcing: Array, state: list[float]) -> _Moved:
        """Twist, twist rate and the state that they end with."""
        kinds = [law.kind if isinstance(law, GearLaw) else steps.OTHER for law in self.laws]
        numbers = [law.numbers if isinstance(law, GearLaw) else law for law in self.laws]
        spare = [[*z] for z in self.memory], [[*z] for z in self.memory]
        twists, rates = ([0.0] * (len(forcing) // len(STAGES)) for _ in range(2))
        listed = kinds, self.beyond, numbers, self.memory, None
        steps.advance(listed, (*spare, any(self.memory)), fixed, forcing.tolist(), state, twists, rates)
        return np.array(twists), np.array(rates), state

    def advance_compiled(self, fixed: _Fixed, forcing: Array, state: list[float]) -> _Moved:
        """The same of laws that can be compiled."""
        code = next((_code_of(law) for law in self.laws if not isinstance(law, GearLaw)), None)
        rows = [law.numbers for law in self.laws]  # type: ignore[attr-defined]
        kinds = [law.kind if isinstance(law, GearLaw) else steps.OTHER for law in self.laws]
        width = max((1, *(len(z) for z in self.memory)))
        memory, numbers = _table(self.memory, width), _table(rows, max((2 * width, *(len(row) for row in rows))))
        table = np.array(kinds, np.int64), np.array(self.beyond, np.bool_), numbers, memory, code
        twists, rates = (np.empty(len(forcing) // len(STAGES)) for _ in range(2))
        spare, ended = (memory.copy(), memory.copy()), np.array(state)
        steps.compiled().advance(table, (*spare, any(self.memory)), fixed, forcing, ended, twists, rates)
        for z, after in zip(self.memory, memory.tolist(), strict=True):
            z[:] = after[: len(z)]
        return twists, rates, ended.tolist()


def _code_of(law: TwistTorque) -> tuple[object, object] | None:
    code = getattr(law, "code", None)
    return code() if code else None


def _table(rows: Sequence[Sequence[float]], width: int) -> Array:
    """(rows, width) filled up with zeros."""
    table = np.zeros((len(rows), width))
    for i, row in enumerate(rows):
        table[i, : len(row)] = row
    return table


@lru_cache(maxsize=64)
def _rule(stiffness: float, damping: float, inertia: float, step_s: float) -> tuple[float, ...]:
    """What `steps` needs of a joint: how twist and rate move in half a step by themselves, the torque per rate and the
    twist per rate that a torque makes in it; then how they move in a whole step, by themselves and by a torque."""
    moves = np.array([[0.0, 1.0, 0.0], [-stiffness / inertia, -damping / inertia, 1.0 / inertia], [0.0, 0.0, 0.0]])
    half, whole = (_exponential(moves * x * step_s) for x in (0.5, 1.0))
    rows = *half[:2, :2].ravel(), 1.0 / half[1, 2], half[0, 2] / half[1, 2], *whole[:2, :2].ravel(), *whole[:2, 2]
    return tuple(float(x) for x in rows)


def _exponential(matrix: Array) -> Array:
    term = total = np.eye(len(matrix))
    for i in range(1, TAYLOR_TERMS):
        term = term @ matrix / i
        total = total + term
    return total


def off_centre(angle_rad: Array, influences: Sequence[Influence]) -> Array:
    """(n,) what an output encoder with the influences' eccentricity says at the true angles."""
    error = np.zeros_like(angle_rad)
    for influence in influences:
        sine, cosine = influence.eccentricity
        error += sine * np.sin(angle_rad) + cosine * np.cos(angle_rad)
    return np.asarray(angle_rad + error)
