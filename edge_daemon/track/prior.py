"""What the recursive estimate believes before data: mean, doubt and drift of each amplitude."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.effects.effect import Effect, Parameter
from edge_daemon.effects.model import Model
from edge_daemon.motion.regressors import DAMPING, STIFFNESS, AmplitudeKey, Regressors
from edge_daemon.records import Array
from edge_daemon.track.recursive import AmplitudeFilter

DIFFUSE = 100.0
"""An amplitude that no model file knows has a prior sd of this many times what would explain the whole torque alone."""
FAINT = 1e-3
"""A column counts for no less than this share of the largest of its effect: in a first stretch at speed what friction
has more at creep shows as 1e-38 (guess)."""
LOST_SHARE = 0.3
"""Friction of the load takes this share of it, sd before data (guess: measured drives lose a tenth). One that may take
more passes for the load itself, until the motion has turned round."""
CONSTANT_DRIFT_PER_SQRT_S = 1e-2
"""The unknown constant may wander by this share of the torque (guess: encoder mounts, slow load)."""
SHAPE_SD = 0.7
"""The logarithm of a shape that no file knows is in this doubt: a factor of two either way (guess)."""
LEAST_SHAPE_SD = 1e-3
"""A shape is never surer than this beforehand: a law that is simulated in steps is no better (guess)."""
OTHERS_DRIFT = 30.0
"""All but the stiffness change this much faster with temperature (guess: viscosity -3 %/K against -0.1 %/K)."""


def prior(
    regressors: Regressors, columns: Array, torque_rms: float, drift_per_h: float, load_power: Array | float = 0.0
) -> AmplitudeFilter:
    """Mean and doubt before data: the model file where it knows, else zero within what could explain the torque.

    (n, k) columns of a first stretch say how large an amplitude would be, (k,) `load_power` that of friction of the
    load, which is not known yet; `drift_per_h` is the stiffness's, relative.
    """
    power, loaded = np.sqrt(np.mean(columns**2, axis=0)), np.asarray(load_power) > 0
    power, most = np.where(loaded, load_power, power), np.full(len(power), math.inf)
    for law, _, place in regressors.rows:
        power[place] = np.maximum(power[place], FAINT * power[place].max(initial=0.0))
        most[place] = [row.upper for row in law.amplitudes]
    power = np.where(power > 0, power, 1.0)
    mean, typical = np.zeros(len(power)), np.minimum(np.where(loaded, LOST_SHARE, 1.0) * torque_rms / power, most)
    sd = np.where(loaded, 1.0, DIFFUSE) * typical
    waves = regressors.kinematic
    typical[waves], sd[waves] = torque_rms, DIFFUSE * torque_rms
    for i, key in enumerate(regressors.keys):
        followed = waves.start <= i < waves.stop  # in a torque, where the file has angles
        known, stated = _stated(regressors, key) if not followed else (math.nan, 0.0)
        if math.isfinite(known) and known != 0:
            least = min(max(abs(known), stated), sd[i])  # a sum may be known of two numbers that are not
            mean[i], typical[i], sd[i] = known, abs(known), least
    for i, (effect, row) in enumerate(regressors.free, regressors.shaping.start):
        value = regressors.shape(effect, row.name)
        mean[i], typical[i], sd[i] = 0.0, 1.0, shape_sd(regressors.model, effect, row, value)
    return AmplitudeFilter(mean, sd, _drift(regressors, typical, torque_rms, drift_per_h))


def _stated(regressors: Regressors, key: AmplitudeKey) -> tuple[float, float]:
    """Value and sd that the model file has of an amplitude; NaN where it has none, infinite where nobody says. Beside a
    shape that the file could not tell either, an amplitude's sd holds for that very shape: with another it may be
    anything."""
    row = regressors.model.effect(key[0])
    found = row.parameters.get(key[1]) if row is not None else None
    if row is None or found is None:
        return math.nan, 0.0
    told = found.identified or all(
        shape.name in row.parameters and row.parameters[shape.name].identified
        for effect, _, _ in regressors.rows
        for shape in effect.free_shapes
        if effect.name == row.name
    )
    doubtful = math.inf if not found.identified else 0.0  # a guess, or of a fit that could not tell it
    return found.value, found.sd if math.isfinite(found.sd) and told else doubtful


def _drift(regressors: Regressors, typical: Array, torque_rms: float, drift_per_h: float) -> Array:
    """Random-walk sd after one second, per amplitude, from the size each typically has."""
    per_sqrt_s = drift_per_h / math.sqrt(3600.0)
    drift = typical * per_sqrt_s * OTHERS_DRIFT
    stiffness, offset = regressors.index(*STIFFNESS), regressors.offset
    if stiffness is not None:
        drift[stiffness] = typical[stiffness] * per_sqrt_s
    if offset is not None:
        drift[offset] = CONSTANT_DRIFT_PER_SQRT_S * torque_rms
    return drift


def shape_sd(model: Model, effect: str, row: Parameter, value: float) -> float:
    """Of a shape's logarithm before data: what the model file says of this `value`, else wide."""
    known = model.effect(effect)
    stated = known.parameters.get(row.name) if known is not None else None
    told = stated.sd / value if stated is not None else math.nan
    return min(max(told, LEAST_SHAPE_SD), SHAPE_SD) if math.isfinite(told) else SHAPE_SD


def held_shapes(regressors: Regressors) -> dict[AmplitudeKey, float]:
    """The shapes that no simulation learns, with the sd of the logarithm of each."""
    found = [(effect, row, held[row.name]) for effect, held, _ in regressors.rows for row in effect.free_shapes]
    return {
        (effect.name, row.name): shape_sd(regressors.model, effect.name, row, value) for effect, row, value in found
    }


def laws_in(regressors: Regressors) -> list[tuple[Effect, dict[str, float], slice]]:
    """Effects beside the linear spring and damper: each with its shape as it is now, and where its columns are."""
    return [row for row in regressors.rows if row[0].name not in (STIFFNESS[0], DAMPING[0])]
