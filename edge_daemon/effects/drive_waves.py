"""Torques of a drive that repeat with an angle: ripple as it is, with load or speed, and of the kinematic error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from edge_daemon.channels import MOTOR_ORDERS
from edge_daemon.effects.algebra import direction
from edge_daemon.effects.drive_load import MOTOR_SHARE, load_of
from edge_daemon.effects.effect import Effect, EffectState, Parameter, Wave
from edge_daemon.effects.waves import in_words, of_input, wave_parameters, wave_slopes, waves
from edge_daemon.records import Array, Mask, Motion

DIRECTED = ("", "direction")
"""Carriers of an effect that has each wave as it is, and with the sign of the motion."""
LOAD, SIGNED_LOAD, DIRECTED_LOAD = LOADS = ("load", "signed load", "directed load")
"""Carriers that are the torque which passes the gear: its size, as a stiffness or a mesh feels it; as it is, by a ratio
that errs; and with the sign of the motion, by friction."""
ONE_WAY = 0.05
"""Part by which a wave may differ from itself with the sign of a motion that goes one way (guess: starts and stops)."""
FASTER = 1e-3
"""Relative rise of the speed by which friction is differentiated."""
LEADING_SHARE = Parameter(
    "share",
    "1",
    "share of the inertia that the error moves: the motor's, or less than 0 the load's, if the encoder is at the motor",
    -1.0,
    1.0,
    0.5,
    "",
    (-0.5, 0.5),
)
"""Its sign tells on which side of the gear the encoder is: what it measures moves as it is said, the rest errs."""


def _ripple(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    columns = waves(motion, rows)
    return np.hstack((columns, direction(motion)[:, None] * columns)), state


def _load_ripple(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    columns, load = waves(motion, rows), load_of(motion, shape)[:, None]
    size = np.abs(load)
    return np.hstack((size * columns, load * columns, size * direction(motion)[:, None] * columns)), state


def _speed_ripple(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    columns = waves(motion, rows)
    speed = motion.velocity_out_rad_s[:, None]
    return np.hstack((np.abs(speed) * columns, speed * columns)), state


def _kinematic_error(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    share = shape["share"]
    load = load_of(motion, {"motor_share": share if share >= 0.0 else 1.0 + share})
    felt = load if motion.drag_Nm is None or share < 0.0 else load - motion.drag_Nm
    turning, ahead = wave_slopes(motion, rows), 0.0 if motion.lead is None else motion.lead[:, None]
    lifted, carried = share * motion.inertia_kg_m2 * turning.lifts, felt[:, None] * turning.slopes
    return (lifted * (1.0 - ahead) - carried if share < 0.0 else lifted - carried / (1.0 + ahead)), state


def carriers_of(names: Sequence[str], rows: Sequence[tuple[Motion, NDArray[np.intp]]], speed: Array) -> Array:
    """(c, m) what a wave is multiplied by, one after the other, each once, at some rows of each motion, whose speeds in
    all are (m,)."""
    parts = np.array([_carrier(name, rows, speed) for name in names])
    return np.asarray(parts[~_repeated(parts)])


def _carrier(name: str, rows: Sequence[tuple[Motion, NDArray[np.intp]]], speed: Array) -> Array:
    if not name:
        return np.ones(len(speed))
    if name == DIRECTED[1]:
        return np.sign(speed)
    if name in LOADS:
        load = np.concatenate([np.asarray(motion.transmitted_Nm)[at] for motion, at in rows], dtype=float)
        return load if name == SIGNED_LOAD else np.abs(load) * (np.sign(speed) if name == DIRECTED_LOAD else 1.0)
    return np.asarray(np.concatenate([getattr(motion, name)[at] for motion, at in rows]))


def told_once(columns: Array, effect: Effect) -> Array:
    """(m, k) of an effect that has each wave with several carriers, the same each time: nought with those that are
    another one but for its sign, as where the motion goes one way alone, or the load pulls one way."""
    count = len(effect.carriers)
    if count == 1:
        return columns
    again = _repeated(columns.reshape(len(columns), count, -1).swapaxes(0, 1).reshape(count, -1))
    return np.where(np.repeat(again, columns.shape[1] // count), 0.0, columns) if again.any() else columns


def _repeated(parts: Array) -> Mask:
    """(c,) whether carriers (c, n), or the waves that they carry, are one before them as it is or with its sign
    turned."""
    products = parts @ parts.T
    size = np.diagonal(products)
    apart = size[:, None] + size - 2 * np.abs(products)
    return np.asarray(np.tril(apart <= ONE_WAY**2 * size, -1).any(axis=1))


def leads(effect: Effect) -> bool:
    """Whether by it the motor turns faster or slower than the output, so that its friction does too."""
    return LEADING_SHARE in effect.shapes


def drag(motion: Motion, told: Iterable[tuple[Effect, Mapping[str, float], Array]]) -> Array:
    """(n,) what the torque of effects, each with its shapes and amplitudes, rises by per relative rise of the speed."""
    faster, out = replace(motion, velocity_out_rad_s=(1 + FASTER) * motion.velocity_out_rad_s), np.zeros(len(motion))
    for effect, shape, amplitudes in told:
        if not effect.carried and not leads(effect):
            rise = effect.columns(faster, shape, None)[0] - effect.columns(motion, shape, None)[0]
            out += rise @ amplitudes / FASTER
    return out


def lead(motion: Motion, told: Iterable[tuple[Effect, Mapping[str, float], Array]]) -> Array:
    """(n,) by how much an error of the angle, of its amplitudes among those of effects, raises a speed, over that."""
    rows = [(wave_slopes(motion, effect.waves).slopes, amplitudes) for effect, _, amplitudes in told if leads(effect)]
    return sum((slopes @ amplitudes for slopes, amplitudes in rows), np.zeros(len(motion)))


def wave_generator_ripple(rows: tuple[Wave, ...]) -> Effect:
    """Ripple of the motor's torque over some waves."""
    return Effect(
        name="wave_generator_ripple",
        balance="drive",
        kind="torque",
        meaning="torque that repeats with the wave generator or the teeth, different in each direction",
        equation=("sum_m (s_m + t_m sgn omega) sin(m theta) + (c_m + d_m sgn omega) cos(m theta), " + in_words(rows)),
        source="Tuttle (1992), MIT AI-TR 1365 (velocity-dependent ripple measured on harmonic drives)",
        amplitudes=wave_parameters("N m", rows, "input", ("", "_directed")),
        shapes=(),
        columns=partial(_ripple, rows),
        waves=rows,
        carriers=("", "direction"),
        over=wave_generator_ripple,
    )


def load_ripple(rows: tuple[Wave, ...]) -> Effect:
    """Ripple that the load makes, over some waves."""
    return Effect(
        name="load_ripple",
        balance="drive",
        kind="torque",
        meaning="torque that repeats with the wave generator or the teeth, and grows with the load, as it acts or rubs",
        equation="sum_m (s_m |tau_load| + t_m tau_load + u_m |tau_load| sgn omega) sin(m theta) + (c_m |tau_load| + "
        "d_m tau_load + e_m |tau_load| sgn omega) cos(m theta), " + in_words(rows),
        source="Taghirad & Belanger (1998), J. Dyn. Sys. Meas. Control 120(4): friction of the load, over an angle",
        amplitudes=wave_parameters("1", rows, "input", ("", "_signed", "_directed")),
        shapes=(MOTOR_SHARE,),
        columns=partial(_load_ripple, rows),
        waves=rows,
        carriers=LOADS,
        over=load_ripple,
        yields_to=("wave_generator_ripple",),
        loaded=True,
    )


def speed_ripple(rows: tuple[Wave, ...]) -> Effect:
    """Ripple that grows with speed, over some waves."""
    return Effect(
        name="speed_ripple",
        balance="drive",
        kind="torque",
        meaning="torque that repeats with the wave generator or the teeth, and grows with speed: drag by the angle",
        equation="sum_m (s_m |omega| + t_m omega) sin(m theta) + (c_m |omega| + d_m omega) cos(m theta), "
        + in_words(rows),
        source="Tuttle (1992), MIT AI-TR 1365 (velocity-dependent ripple measured on harmonic drives)",
        amplitudes=wave_parameters("N m s/rad", rows, "input", ("", "_directed")),
        shapes=(),
        columns=partial(_speed_ripple, rows),
        waves=rows,
        waves_of="wave_generator_ripple",
        over=speed_ripple,
        yields_to=("wave_generator_ripple", "joint_elasticity"),
    )


def kinematic_error(rows: tuple[Wave, ...]) -> Effect:
    """The error of the transmission, felt through the inertia behind the encoder, over some waves."""
    return Effect(
        name="kinematic_error",
        balance="drive",
        kind="torque",
        meaning="transmission error: the motor's angle leads or lags, which moves its inertia and changes the ratio",
        equation="s J d2e/dt2 - (tau_load - omega dF/domega) de/dtheta_out, F all friction, which is the motor's, "
        "e = sum_m s_m sin(m theta) + c_m cos(m theta), " + in_words(rows),
        source="Ghorbel, Gandhi & Alpeter (2001), ASME J. Mech. Design 123(1): kinematic error; d'Alembert's principle",
        amplitudes=wave_parameters("rad", rows, "input"),
        shapes=(LEADING_SHARE,),
        columns=partial(_kinematic_error, rows),
        waves=rows,
        waves_of="wave_generator_ripple",
        over=kinematic_error,
        yields_to=("wave_generator_ripple", "joint_elasticity"),
    )


ROWS = tuple(
    row(of_input(*MOTOR_ORDERS)) for row in (wave_generator_ripple, load_ripple, speed_ripple, kinematic_error)
)
