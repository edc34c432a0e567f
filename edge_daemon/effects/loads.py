"""Torques from outside the gear, and inertia that the model misses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from edge_daemon.effects.algebra import stack
from edge_daemon.effects.effect import Effect, EffectState, Parameter, Twin
from edge_daemon.records import Array, Motion


def _gravity(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(-np.sin(motion.theta_out_rad), -np.cos(motion.theta_out_rad)), state


def _constant(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(-np.ones(len(motion))), state


def _inertia_error(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.acceleration_out_rad_s2), state


ROWS = (
    Effect(
        name="gravity_load",
        balance="torsion",
        kind="torque",
        meaning="weight or unbalance on the output",
        equation="-(g_s sin theta_out + g_c cos theta_out)",
        source="Newton: torque of a weight on a lever in a plane",
        amplitudes=(
            Parameter("sine", "N m", "weight torque at an output angle of 90 degrees"),
            Parameter("cosine", "N m", "weight torque at an output angle of zero"),
        ),
        shapes=(),
        columns=_gravity,
        twins=(
            Twin(
                "encoder_eccentricity",
                "repeat with another payload or axis orientation: gravity changes with them, an eccentric encoder "
                "does not",
            ),
        ),
        yields_to=("constant_load",),
        steady="nearly",
    ),
    Effect(
        name="constant_load",
        balance="torsion",
        kind="torque",
        meaning="a steady load on the output; an encoder zero offset times the stiffness looks the same",
        equation="-tau_0",
        source="Newton: torque balance at rest",
        amplitudes=(Parameter("load", "N m", "load torque, against positive motion"),),
        shapes=(),
        columns=_constant,
        told_by="zeros",
        steady="exactly",
    ),
    Effect(
        name="inertia_error",
        balance="torsion",
        kind="torque",
        meaning="inertia between gear and torque sensor, or a payload that the model does not know",
        equation="dJ alpha_out",
        source="Newton; identifiable only against a measured output torque",
        amplitudes=(Parameter("inertia", "kg m^2", "inertia the model misses"),),
        shapes=(),
        columns=_inertia_error,
        needs=("torque_out_Nm",),
        follows="acceleration_out_rad_s2",
    ),
)
