"""From the predicted twist of a dry gear to rows of the regression that all other models use.

Measured minus predicted twist, times the stiffness, has the unit and, for slow motion, the columns of the balance of
torques: twist for the stiffness, its rate for the damping, a sign for the friction.
"""

from __future__ import annotations

import numpy as np

from edge_daemon.effects.model import Model
from edge_daemon.estimate.dry import DryTwist, Gear, Predicted
from edge_daemon.estimate.learning import Equation
from edge_daemon.estimate.prior import STIFFNESS
from edge_daemon.estimate.recursive import ColumnNoise
from edge_daemon.estimate.regressors import KINEMATIC, Key, Linearisation, Regressors, TorqueNoise
from edge_daemon.estimate.streaming import Stretch
from edge_daemon.records import Array

DAMPING: Key = ("viscous_damping", "damping")
COULOMB: Key = ("coulomb_friction", "friction")
FARTHEST = 5.0
"""times the stiffness known before, or its reciprocal: beyond it an estimate has gone astray"""


class DryPrediction:
    """Measures each stretch against the predicted twist."""

    def __init__(self, regressors: Regressors) -> None:
        self._regressors = regressors
        self._twist = DryTwist(regressors.model.ratio)
        self.friction_Nm: Array | None = None
        """(n,) friction behind the balance filter, of the newest stretch; None while it is not known"""

    def forget(self) -> None:
        """Start from the measured twist with the next samples."""
        self._twist.forget()

    def equation(self, stretch: Stretch, value: Array, point: Linearisation, noise_rad2: float) -> Equation:
        """Rows linear around the amplitudes `value` (k,); `noise_rad2` is the variance of a sample of the twist."""
        assert stretch.arguments is not None
        usable, light = stretch.valid, stretch.arguments
        if not usable.all():
            self.forget()
        gear = gear_of(value, point, self._regressors)
        seen = self._twist.predict(light, gear)
        n, k = len(light.motion), len(value)
        white = TorqueNoise(ColumnNoise(np.zeros((k, k)), np.zeros(k)), gear.stiffness**2 * noise_rad2)
        self.friction_Nm = None
        if seen is None or not seen.settled:
            return Equation(light.motion, np.zeros((n, k)), np.zeros(n), np.zeros(n, dtype=bool), usable, white)
        self.friction_Nm = self._twist.friction_Nm(light.balance)
        columns, torque = rows_of(seen, gear, value, point, self._regressors)
        good = np.isfinite(torque) if usable.all() else np.zeros(n, dtype=bool)
        return Equation(light.motion, columns, torque, good, usable, white)


def can_be_predicted(model: Model, torque_measured: bool) -> bool:
    """Whether the twist of this model can be simulated here: spring, damper and dry friction, driven by the motor."""
    names = {effect.name for effect in model.effects} - {KINEMATIC}
    return model.balance == "torsion" and not torque_measured and names == {STIFFNESS[0], DAMPING[0], COULOMB[0]}


def is_credible(value: Array, point: Linearisation, regressors: Regressors) -> bool:
    """Whether a gear of these amplitudes (k,) may be simulated."""
    share = float(value[_column(regressors, STIFFNESS)]) / point.stiffness
    return 1 / FARTHEST < share < FARTHEST


def gear_of(value: Array, point: Linearisation, regressors: Regressors) -> Gear:
    """What the amplitudes (k,) say of the gear, within what can be simulated."""
    stiffness = max(float(value[_column(regressors, STIFFNESS)]), point.stiffness / FARTHEST)
    offset = regressors.offset
    return Gear(
        inertia=regressors.model.output_inertia_kg_m2,
        stiffness=stiffness,
        damping=float(value[_column(regressors, DAMPING)]),
        friction=max(float(value[_column(regressors, COULOMB)]), 0.0),
        smoothing=regressors.shape(COULOMB[0], "smoothing"),
        error_rad=point.whole_error(stiffness, value[regressors.kinematic]),
        zero_rad=float(value[offset]) / stiffness if offset is not None else 0.0,
    )


def rows_of(
    seen: Predicted, gear: Gear, value: Array, point: Linearisation, regressors: Regressors
) -> tuple[Array, Array]:
    """(n, k) columns and (n,) torque: columns @ amplitudes = torque, linear around `value` (k,)."""
    by_waves = seen.by_error / gear.stiffness
    columns = np.zeros((len(by_waves), len(value)))
    place, zero, stiffness = regressors.kinematic, regressors.offset, _column(regressors, STIFFNESS)
    waves = value[place] - point.stiffness * point.error_rad
    columns[:, place] = by_waves
    columns[:, stiffness] = seen.by_stiffness - by_waves @ waves / gear.stiffness
    columns[:, _column(regressors, DAMPING)] = seen.by_damping
    columns[:, _column(regressors, COULOMB)] = seen.by_friction
    if zero is not None:
        columns[:, zero] = -1 / gear.stiffness
        columns[:, stiffness] += gear.zero_rad / gear.stiffness
    columns *= -gear.stiffness
    return columns, columns @ value - gear.stiffness * (seen.seen_rad - seen.twist_rad)


def _column(regressors: Regressors, key: Key) -> int:
    i = regressors.index(*key)
    assert i is not None
    return i
