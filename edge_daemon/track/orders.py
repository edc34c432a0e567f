"""What repeats with an angle of the gear, order by order: teeth that wear, a wave generator or an encoder off centre.

The size of a wave is that of its sine and cosine together, in the form in which it is largest where it has one for each
sign of the motion or the load. What is in doubt across them makes a small one larger than it is (Rice, Bell System
Technical Journal 24, 1945): that goes into its deviation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from edge_daemon.effects.catalogue import find
from edge_daemon.effects.effect import Wave
from edge_daemon.effects.model import Teeth
from edge_daemon.effects.order_names import name_of
from edge_daemon.effects.waves import ANGLES, FORMS, label, of_input
from edge_daemon.motion.regressors import KINEMATIC, STIFFNESS, AmplitudeKey
from edge_daemon.motion.streaming import ORDERS
from edge_daemon.records import Array, Estimate, Status
from edge_daemon.track.tracking import BalanceTracker


class OrderEstimate(NamedTuple):
    """The size of one wave."""

    effect: str
    wave: Wave
    meaning: str
    estimate: Estimate


def orders_of(tracker: BalanceTracker) -> Iterator[OrderEstimate]:
    """Every wave of the model in force, those of the kinematic error first."""
    regressors, model = tracker.regressors, tracker.model
    if STIFFNESS in regressors.keys and regressors.kinematic.stop > regressors.kinematic.start:
        parts, known = tracker.error_rad.reshape(-1, 2), tracker.stiffness
        for wave, own in zip(of_input(*ORDERS), parts, strict=True):
            yield _order(tracker, KINEMATIC, wave, "input", known, own)
    for effect, _, _ in regressors.rows:
        home = find(effect.name, model.balance).waves[0].angle if effect.waves else ""
        for wave in effect.waves:
            if _keys(effect.name, wave, home)[0] in regressors.keys:
                yield _order(tracker, effect.name, wave, home)


def _keys(effect: str, wave: Wave, home: str, form: str = "") -> tuple[AmplitudeKey, AmplitudeKey]:
    return (effect, f"sine_{label(wave, home)}{form}"), (effect, f"cosine_{label(wave, home)}{form}")


def _largest(tracker: BalanceTracker, effect: str, wave: Wave, home: str) -> tuple[AmplitudeKey, AmplitudeKey]:
    """The amplitudes of the form in which a wave is largest."""
    rows = [_keys(effect, wave, home, form) for form in FORMS]
    rows = [keys for keys in rows if keys[0] in tracker.regressors.keys] or rows[:1]
    return max(rows, key=lambda keys: float(np.hypot(*tracker.among(_places(tracker, keys))[0])) if rows[1:] else 0.0)


def _places(tracker: BalanceTracker, keys: tuple[AmplitudeKey, AmplitudeKey]) -> list[int]:
    return [i for key in keys if (i := tracker.regressors.index(*key)) is not None]


def _order(
    tracker: BalanceTracker, effect: str, wave: Wave, home: str, per_unit: float = 1.0, own: Array | None = None
) -> OrderEstimate:
    """One wave, of which an amplitude is `per_unit` times its `own` size (2,), if that is known; NaN for unknown."""
    keys, model = _largest(tracker, effect, wave, home), tracker.model
    places = _places(tracker, keys)
    unit = find(effect, model.balance).amplitudes[0].unit
    status = max((tracker.estimate("", "", key).status for key in keys), key=[*Status].index)
    parts, covariance = tracker.among(places)
    value, sd = _size(parts if own is None else own + 0.0 * per_unit, covariance / per_unit**2)
    if status is Status.VALID and not math.isfinite(value + sd):
        status = Status.INVALID
    found = Estimate(f"{effect}_{label(wave, home)}", value, sd, unit, status, tracker.moved_s)
    return OrderEstimate(effect, wave, _meaning(effect, wave, model.ratio, model.teeth), found)


@cache
def _meaning(effect: str, wave: Wave, ratio: float, teeth: Teeth | None) -> str:
    meaning = f"{effect.replace('_', ' ')}, {wave.order:.6g} per turn of the {ANGLES[wave.angle]}"
    cause = name_of(wave, ratio, teeth)
    return f"{meaning}: {cause}" if cause else meaning


def _size(parts: Array, covariance: Array) -> tuple[float, float]:
    """Of sine and cosine (2,) with (2, 2) covariance: the wave's amplitude and its sd."""
    size = float(np.hypot(*parts))
    if not size > 0:
        return size, math.sqrt(max(float(np.trace(covariance)), 0.0))
    along, across = parts / size, np.array([-parts[1], parts[0]]) / size
    sd, sideways = (math.sqrt(max(float(row @ covariance @ row), 0.0)) for row in (along, across))
    return size, math.hypot(sd, min(sideways**2 / (2 * size), sideways))
