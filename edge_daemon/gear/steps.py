"""The laws of the simulated gear on plain numbers, and the rule that steps them.

    phi'' = (push - K phi - B phi' - torques(phi, phi', what is remembered)) / J

The linear part is exact, by its matrix exponential; the further torques are taken in the middle of a step (exponential
midpoint rule: Hochbruck, Ostermann 2010, Acta Numerica 19, section 2). Each step is made whole and in two halves, and
(4 halves - whole) / 3 takes away the error of second order (Richardson 1911).

A live drive runs this file as it is written; `compiled` runs a copy of it through numba for a whole recording.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from math import copysign, exp, pow, sin, tanh
from types import ModuleType
from typing import Any, TypeVar

REVERSAL_WIDTH_RAD_S = 1e-3
"""Friction turns round over this twist rate; the rates in use are some 1e-2."""
OUTPUT_WIDTH_RAD_S = 1e-2
"""Output friction turns round over this output speed; speeds in use are some rad/s."""
RATE_TOLERANCE_RAD_S = 1e-6
"""Newton step after which the twist rate counts as solved: what is left is its square over the reversal width, 1e-9,
where the rate itself is around 1e-2."""
MOST_ITERATIONS = 40
(OTHER, POLYNOMIAL, PIECEWISE, DEAD_ZONE, COULOMB, STRIBECK, BOUC_WEN, MAXWELL_SLIP, LUGRE, DAHL, GRAVITY,
 OUTPUT_FRICTION, SPEED_WAVE, TWIST_TIMES_ANGLE, LOPSIDED_SLIP) = range(15)  # fmt: skip
"""Kinds of laws; what `OTHER` is, its own object says, or two functions of its own: its torque, what it remembers."""

LawNumbers = Any
"""(m,) of a law; for `OTHER` the law itself"""
LawMemory = Any
"""(k,) what a law remembers"""
UNCOUNTED: dict[str, Any] = {"_nrt": False}
"""No function here makes arrays, and none need count who holds them: counting costs as much as a law."""
F = TypeVar("F", bound=Callable[..., object])


def _as_written(function: F) -> F:
    return function


part: Callable[[F], F] = globals().get("compiler", _as_written)


@cache
def compiled() -> ModuleType:
    """This file once more, as machine code: a hundred times as fast, after half a second for the compiler."""
    import numba

    spec = importlib.util.spec_from_file_location(f"{__name__}_compiled", __file__)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # by this name the cache of what was compiled finds it again
    module.__dict__["compiler"] = numba.njit(cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
    spec.loader.exec_module(module)
    return module


# what the laws do: torque on the output, positive with the twist, and its derivative to the twist rate (0 if small)


@part
def _dry(level: float, rate: float, width: float) -> tuple[float, float]:
    """level * sgn(rate), as a steep tanh."""
    sign = tanh(rate / width)
    return level * sign, level * (1.0 - sign * sign) / width


@part
def _piecewise(p: LawNumbers, phi: float) -> float:
    size = abs(phi)
    torque: float = p[2] * max(0.0, size - p[0]) + p[3] * max(0.0, size - p[1])
    return copysign(torque, phi)


@part
def _bump(x: float) -> float:
    return exp(-x * x) if -20.0 < x < 20.0 else 0.0


@part
def _stribeck(p: LawNumbers, dphi: float) -> tuple[float, float]:
    """(Fc + (Fs - Fc)*exp(-(dphi/vs)^2)) * sgn(dphi)"""
    x = dphi / p[2]
    bump = (p[1] - p[0]) * _bump(x)
    torque, slope = _dry(p[0] + bump, dphi, REVERSAL_WIDTH_RAD_S)
    return torque, slope - 2 * x / p[2] * bump * tanh(dphi / REVERSAL_WIDTH_RAD_S)


@part
def _bouc_wen(p: LawNumbers, z: float, travel: float) -> float:
    """What z has become: z' = dphi/knee * (1 - |z|^n * (beta*sgn(dphi*z) + 1 - beta)); Wen 1976, J. Eng. Mech. 102."""
    travel = travel / p[1]
    shape = p[2] * (1.0 if travel * z > 0 else -1.0) + 1.0 - p[2]
    trial = z + 0.5 * travel * (1.0 - pow(abs(z), p[3]) * shape)
    grown: float = z + travel * (1.0 - pow(abs(trial), p[3]) * shape)
    return grown


@part
def _slipped(z: float, limit: float, travel: float) -> float:
    return max(-limit, min(limit, z + travel))


@part
def _maxwell_slip(p: LawNumbers, z: LawMemory, travel: float) -> float:
    """Springs that slip at their own limits: sum of k_i * z_i, |z_i| <= limit_i; Lampaert 2003."""
    total = 0.0
    for i in range(len(z)):
        total += p[2 * i] * (z[i] + _slipped(z[i], p[2 * i + 1], travel))
    return 0.5 * total


@part
def _grip(taper_rad: float, phi: float) -> float:
    """How firmly pairs are pressed together that the twist loads or relieves, over that at none."""
    return max(0.02, 1.0 + phi / taper_rad)


@part
def _lopsided_slip(p: LawNumbers, z: LawMemory, travel: float) -> float:
    """Springs that slip at limits in proportion to their grip; the first that is remembered is the twist."""
    total, grip = 0.0, _grip(p[0], z[0] + travel)
    for i in range(1, int(p[1]) + 1):
        total += p[2 * i] * 0.5 * (z[i] + _slipped(z[i], p[2 * i + 1] * grip, travel))
    return total


@part
def _lugre(p: LawNumbers, z: float, step_s: float, dphi: float) -> float:
    """What z has become: z' = dphi - s0*|dphi|*z/g(dphi); Canudas de Wit et al. 1995, IEEE TAC 40(3), eq. (2)-(5).

    Exact for a rate that stays."""
    g = p[0] + (p[1] - p[0]) * _bump(dphi / p[2])
    end = copysign(g / p[3], dphi)
    return end + (z - end) * exp(-p[3] * abs(dphi) * step_s / g)


@part
def _dahl(p: LawNumbers, torque: float, travel: float) -> float:
    """dF/dphi = s*(1 - F/Fc*sgn(dphi)); Dahl 1976, AIAA J. 14(12), eq. (7) with exponent 1. Exact."""
    end = copysign(p[0], travel)
    return end + (torque - end) * exp(-p[1] * abs(travel) / p[0])


if part is _as_written:

    def _other(code: Any, p: LawNumbers, z: LawMemory, step_s: float, at: Any) -> Any:
        return p.at(z, step_s, *at)

    def _grow_other(code: Any, p: LawNumbers, z: LawMemory, step_s: float, dphi: float) -> None:
        z[:] = p.grown(z, step_s, dphi)

else:

    @part
    def _other(code: Any, p: LawNumbers, z: LawMemory, step_s: float, at: Any) -> Any:
        if code is None:  # known to the compiler, which leaves out the other branch
            return 0.0, 0.0
        return code[0](p, z, step_s, at[0], at[1], at[2], at[3])

    @part
    def _grow_other(code: Any, p: LawNumbers, z: LawMemory, step_s: float, dphi: float) -> None:
        if code is not None:
            code[1](p, z, step_s, dphi)


@part
def torque_of(
    kind: int, p: LawNumbers, z: LawMemory, step_s: float, phi: float, dphi: float, speed: float, angle: float,
    code: Any = None,
) -> tuple[float, float]:  # fmt: skip
    """A law's torque [N m] in the middle of a step, and its derivative to the twist rate."""
    if kind == COULOMB:
        return _dry(p[0], dphi, REVERSAL_WIDTH_RAD_S)
    if kind == STRIBECK:
        return _stribeck(p, dphi)
    if kind == BOUC_WEN:
        return p[0] * 0.5 * (z[0] + _bouc_wen(p, z[0], dphi * step_s)), 0.0
    if kind == MAXWELL_SLIP:
        return _maxwell_slip(p, z, dphi * step_s), 0.0
    if kind == LOPSIDED_SLIP:
        return _lopsided_slip(p, z, dphi * step_s), 0.0
    if kind == DAHL:
        return 0.5 * (z[0] + _dahl(p, z[0], dphi * step_s)), 0.0
    if kind == LUGRE:
        grown = _lugre(p, z[0], step_s, dphi)
        return p[3] * 0.5 * (z[0] + grown) + p[4] * (grown - z[0]) / step_s, 0.0
    if kind == DEAD_ZONE:
        return -p[1] * max(-p[0], min(p[0], phi)), 0.0
    if kind == PIECEWISE:
        return _piecewise(p, phi), 0.0
    if kind == POLYNOMIAL:
        return (p[0] + p[1] * phi) * phi * phi, 0.0
    if kind == GRAVITY:
        return -p[0] * sin(angle + p[1]), 0.0
    if kind == OUTPUT_FRICTION:
        torque, slope = _dry(p[1], speed, OUTPUT_WIDTH_RAD_S)
        return -p[0] * speed - torque, p[0] + slope
    if kind == SPEED_WAVE:
        return p[0] * sin(6.283185307179586 * speed / p[1]), 0.0
    if kind == TWIST_TIMES_ANGLE:
        return p[0] * phi * sin(p[1] * angle + p[2]), 0.0
    answer: tuple[float, float] = _other(code, p, z, step_s, (phi, dphi, speed, angle))
    return answer


@part
def remember(kind: int, p: LawNumbers, z: LawMemory, step_s: float, dphi: float, code: Any = None) -> None:
    """What a law keeps of a finished step."""
    if kind == BOUC_WEN:
        z[0] = _bouc_wen(p, z[0], dphi * step_s)
    elif kind == MAXWELL_SLIP:
        for i in range(len(z)):
            z[i] = _slipped(z[i], p[2 * i + 1], dphi * step_s)
    elif kind == LOPSIDED_SLIP:
        z[0] += dphi * step_s
        for i in range(1, int(p[1]) + 1):
            z[i] = _slipped(z[i], p[2 * i + 1] * _grip(p[0], z[0]), dphi * step_s)
    elif kind == DAHL:
        z[0] = _dahl(p, z[0], dphi * step_s)
    elif kind == LUGRE:
        z[0] = _lugre(p, z[0], step_s, dphi)
    elif kind == OTHER:
        _grow_other(code, p, z, step_s, dphi)


@part
def tooth_friction(mu: float, carried: float, slope: float, dphi: float) -> tuple[float, float]:
    """mu * |tau| * sgn(dphi), where tau is all that passes the teeth: what is carried, and this friction itself.

    Amontons' law; the force between the teeth is in proportion to the torque that passes them.
    """
    sign = tanh(dphi / REVERSAL_WIDTH_RAD_S)
    share = mu * sign * copysign(1.0, carried)
    passed = carried / (1.0 - share)
    turning = mu * abs(passed) * (1.0 - sign * sign) / REVERSAL_WIDTH_RAD_S
    return share * passed, (turning + share * slope) / (1.0 - share)


# the rule


@part
def _further(
    laws: Any, joint: Any, step_s: float, at: Any, phi: float, dphi: float, speed: float, angle: float
) -> tuple[float, float]:
    """All further torques, and their derivative to the twist rate: those of the gear, what its teeth make of all that
    they pass on, and the loads beyond. `joint`: K, B and mu of the teeth; `at`: what K and B differ by here."""
    kinds, beyond, numbers, memory, code = laws
    torque, slope = at[0] * phi + at[1] * dphi, at[1]
    load = load_slope = 0.0
    for i in range(len(kinds)):
        own, own_slope = torque_of(kinds[i], numbers[i], memory[i], step_s, phi, dphi, speed, angle, code)
        if beyond[i]:
            load, load_slope = load + own, load_slope + own_slope
        else:
            torque, slope = torque + own, slope + own_slope
    if joint[2] > 0.0:
        carried = joint[0] * phi + joint[1] * dphi + torque
        own, own_slope = tooth_friction(joint[2], carried, joint[1] + slope, dphi)
        torque, slope = torque + own, slope + own_slope
    return torque + load, slope + load_slope


@part
def _middle(laws: Any, joint: Any, rule: Any, step_s: float, at: Any, free: tuple[float, float], guess: float) -> float:
    """The twist rate that balances the middle of a step: Newton, halving the bracket when it would leave it.

    `free`: twist and its rate there, of a joint without torques; `at`: change of K and of B, push, output speed and
    angle of a rigid gear.
    """
    low, high, middle, gain = -1e300, 1e300, guess, rule[4]
    for _ in range(MOST_ITERATIONS):
        phi = free[0] + (middle - free[1]) * rule[5]
        torque, slope = _further(laws, joint, step_s, at, phi, middle, at[3] - middle, at[4] - phi)
        excess = gain * (middle - free[1]) + torque - at[2]
        if excess > 0:
            high = middle
        else:
            low = middle
        step = excess / (gain + slope)
        following: float = middle - step
        if -RATE_TOLERANCE_RAD_S < step < RATE_TOLERANCE_RAD_S:
            return following
        if not low <= following <= high:
            following = 0.5 * (low + high)
        middle = following
    return middle


@part
def _step(
    laws: Any, joint: Any, rule: Any, step_s: float, at: Any, phi: float, dphi: float, guess: float
) -> tuple[float, float, float]:
    """Twist and its rate after a step, and the rate in its middle."""
    free = rule[0] * phi + rule[1] * dphi, rule[2] * phi + rule[3] * dphi
    middle = _middle(laws, joint, rule, step_s, at, free, guess)
    torque = (middle - free[1]) * rule[4]
    after = rule[6] * phi + rule[7] * dphi + rule[10] * torque
    return after, rule[8] * phi + rule[9] * dphi + rule[11] * torque, middle


@part
def _remember_all(laws: Any, step_s: float, middle: float) -> None:
    kinds, _beyond, numbers, memory, code = laws
    for i in range(len(kinds)):
        remember(kinds[i], numbers[i], memory[i], step_s, middle, code)


@part
def _both(laws: Any, before: Any, whole: Any, remembers: bool, stage: int) -> None:
    """LawMemory of the whole step (1) set aside and that of before put back, or (2) joined with that of the halves."""
    if not remembers:
        return
    memory = laws[3]
    for i in range(len(memory)):
        for j in range(len(memory[i])):
            if stage == 0:
                before[i][j] = memory[i][j]
            elif stage == 1:
                whole[i][j], memory[i][j] = memory[i][j], before[i][j]
            else:
                memory[i][j] = (4.0 * memory[i][j] - whole[i][j]) / 3.0


@part
def advance(laws: Any, room: Any, fixed: Any, forcing: Any, state: Any, twists: Any, rates: Any) -> None:
    """The twist and its rate at the end of each step.

    `forcing`: at a quarter, the half and three quarters of each, as `_middle` has it; `state`: twist, its rate and
    change of rate over a step, before and then after."""
    joint, (whole_rule, half_rule), step_s = fixed
    before, whole, remembers = room
    phi, dphi, change = state[0], state[1], state[2]
    half_s = 0.5 * step_s
    for n in range(len(twists)):
        first, mid, last = forcing[3 * n], forcing[3 * n + 1], forcing[3 * n + 2]
        _both(laws, before, whole, remembers, 0)
        far, far_rate, middle = _step(laws, joint, whole_rule, step_s, mid, phi, dphi, dphi + 0.5 * change)
        if remembers:
            _remember_all(laws, step_s, middle)
        _both(laws, before, whole, remembers, 1)
        near, near_rate, early = _step(laws, joint, half_rule, half_s, first, phi, dphi, 0.5 * (dphi + middle))
        if remembers:
            _remember_all(laws, half_s, early)
        near, near_rate, late = _step(laws, joint, half_rule, half_s, last, near, near_rate, 2 * middle - early)
        if remembers:
            _remember_all(laws, half_s, late)
        _both(laws, before, whole, remembers, 2)
        phi, start = (4.0 * near - far) / 3.0, dphi
        dphi = (4.0 * near_rate - far_rate) / 3.0
        change = dphi - start
        twists[n], rates[n] = phi, dphi
    state[0], state[1], state[2] = phi, dphi, change
