"""The stiffness over the twist, K(phi), in the three forms in use, each with its band.

polynomial: K + 2 k1 phi + 3 k2 phi^2 (second article's K(phi) as a polynomial). piecewise: the makers' K1, K2, K3 with
corners. table: K at stations of the twist, straight between them (its look-up table); it assumes no law, so it judges
the other two. A band is one standard deviation of the curve, from the joint covariance of its numbers; the table's
includes how far it still moves when its stations are set twice as close.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.effects.effect import Effect, EffectState, Parameter
from edge_daemon.effects.model import Model, ModelEffect, ModelError
from edge_daemon.identify.deviations import excess_power, numbers, spread
from edge_daemon.identify.fit import Fitted, fit
from edge_daemon.identify.solution import STIFFNESS, Solution, Term
from edge_daemon.records import Array, Motion, Recorded

SHAPES = ("polynomial_stiffness", "piecewise_stiffness")
STATIONS = 7
"""The coarse table has so many stations; the one shown has a station between any two."""
REACHED_SHARE = 0.002
"""A twist that is held for less than this share of the time, on either side, does not count as reached."""
CURVE_POINTS = 41
STEP = 1e-4
"""Relative step of the numeric derivative of a curve by its numbers; the curves are smooth in them."""
SIMPLER_SHARE = 0.02
"""A form must lower the held-out error by more than this, or the simpler one is kept (guess)."""

Extended = Callable[[Model, Fitted, Sequence[Recorded]], Fitted]
"""(larger model, fit of the smaller one, recordings) -> fit of the larger one: the search of `add`"""
Curve = Callable[[Mapping[tuple[str, str], float], Array], Array]


@dataclass(frozen=True, slots=True)
class Form:
    """One form of K(phi)."""

    name: str
    stiffness_Nm_per_rad: Array
    """(g,) at the twists of the map"""
    sd_Nm_per_rad: Array
    """(g,)"""
    nrmse: float
    """held-out error over rms torque"""
    numbers: Mapping[str, tuple[float, float, str]]
    """what it is made of: name -> (value, sd, unit)"""


@dataclass(frozen=True, slots=True)
class StiffnessMap:
    """All forms on one recording."""

    twist_rad: Array
    """(g,) over the range that the motion reached"""
    torque_Nm: Array
    """(g,) of the spring at these twists, by the best form"""
    forms: tuple[Form, ...]
    best: Form
    """the simplest whose held-out error is not clearly above the least"""


def stiffness_map(recordings: Sequence[Recorded], model: Model, extended: Extended) -> StiffnessMap:
    """K(phi) of the joint; whatever else `model` holds is fitted with it. Raises `BadInput`."""
    if model.balance != "torsion":
        raise ModelError(f"joint.balance: {model.balance!r}: expected 'torsion': a stiffness wants two encoders")
    plain = _without_shapes(model)
    linear = fit(recordings, plain)
    twist = _reached(linear)
    forms = [form_of("linear", linear, linear.solution, straight, twist)]
    for name, effect, curve in (
        ("polynomial", "polynomial_stiffness", _polynomial),
        ("piecewise", "piecewise_stiffness", _piecewise),
    ):
        fitted = extended(plain.with_effect(ModelEffect(effect)), linear, recordings)
        forms.append(form_of(name, fitted, fitted.solution, curve, twist))
    forms.append(_table(linear, twist))
    best = _best(forms)
    return StiffnessMap(twist, _torque(twist, best.stiffness_Nm_per_rad), tuple(forms), best)


def _torque(twist: Array, stiffness: Array) -> Array:
    """(g,) the integral of the curve from zero twist."""
    steps = np.diff(twist) * (stiffness[1:] + stiffness[:-1]) / 2
    from_end = np.concatenate(([0.0], np.cumsum(steps)))
    return np.asarray(from_end - np.interp(0.0, twist, from_end))


def _without_shapes(model: Model) -> Model:
    effects = tuple(row for row in model.effects if row.name not in SHAPES)
    if STIFFNESS[0] not in (row.name for row in effects):
        effects = (ModelEffect(STIFFNESS[0]), *effects)
    return replace(model, effects=effects)


def _reached(fitted: Fitted) -> Array:
    """(g,) the twists between those that the gear goes beyond for a moment only."""
    seen = np.concatenate([motion.twist_rad[np.isfinite(motion.twist_rad)] for motion in fitted.problem.motions])
    low, high = np.quantile(seen, (REACHED_SHARE, 1 - REACHED_SHARE))
    if not low < 0 < high:
        raise ModelError(f"twist from {low:.3g} to {high:.3g} rad: expected torque to both sides of zero")
    return np.linspace(low, high, CURVE_POINTS)


def form_of(name: str, fitted: Fitted, solution: Solution, curve: Curve, twist: Array) -> Form:
    """The curve of a structure solved on the bench of a fit, and its band by the numbers' joint covariance."""
    problem, rows = fitted.problem, numbers(solution)
    keys = [(term.effect.name, row.name) for term, row, _ in rows]
    values = np.array([value for _, _, value in rows])
    covariance, _ = spread(solution, problem, excess_power(solution, fitted.floor))
    if solution is fitted.solution:  # whose numbers simulated angles may have told better than the torque does
        known = {row.name: row.parameters for row in fitted.model.effects}
        own = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
        told = [known[key[0]][key[1]].sd if key[0] in known else sd for key, sd in zip(keys, own.tolist(), strict=True)]
        times = np.array(told) / own  # a sensor's lag is fitted beside the model and is none of its numbers
        covariance = covariance * np.outer(times, times)

    def at(point: Array) -> Array:
        return curve(dict(zip(keys, point.tolist(), strict=True)), twist)

    slope = np.column_stack([_by(at, values, i) for i in range(len(values))])
    sd = np.sqrt(np.maximum(np.einsum("gi,ij,gj->g", slope, covariance, slope), 0.0))
    own = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    shown = {
        f"{effect}.{row}": (float(value), float(own[i]), rows[i][1].unit)
        for i, ((effect, row), value) in enumerate(zip(keys, values, strict=True))
        if effect in (STIFFNESS[0], *SHAPES)
    }
    return Form(name, at(values), sd, solution.rmse / problem.rms, shown)


def _by(at: Callable[[Array], Array], values: Array, i: int) -> Array:
    step = STEP * (abs(values[i]) or 1.0)
    up, down = values.copy(), values.copy()
    up[i] += step
    down[i] -= step
    return (at(up) - at(down)) / (2 * step)


def straight(p: Mapping[tuple[str, str], float], twist: Array) -> Array:
    """The stiffness of a linear spring [N m/rad] at each twist."""
    return np.full(len(twist), p[STIFFNESS])


def _polynomial(p: Mapping[tuple[str, str], float], twist: Array) -> Array:
    k1, k2 = p[SHAPES[0], "k1"], p[SHAPES[0], "k2"]
    return np.asarray(p[STIFFNESS] + 2 * k1 * twist + 3 * k2 * twist**2)


def _piecewise(p: Mapping[tuple[str, str], float], twist: Array) -> Array:
    first = p[SHAPES[1], "corner_1"]
    second = first + p[SHAPES[1], "corner_gap"]
    size = np.abs(twist)
    return np.asarray(p[STIFFNESS] + p[SHAPES[1], "rise_1"] * (size > first) + p[SHAPES[1], "rise_2"] * (size > second))


# ---- the table

TABLE = "stiffness_table"


def _table(linear: Fitted, twist: Array) -> Form:
    """K at stations, with a band that holds what the straight pieces cannot follow."""
    coarse, fine = (_stations(twist, count) for count in (STATIONS, 2 * STATIONS - 1))
    rough, _ = _table_at(linear, coarse, twist)
    form, solve = _table_at(linear, fine, twist)
    widened = np.hypot(form.sd_Nm_per_rad, form.stiffness_Nm_per_rad - rough.stiffness_Nm_per_rad)
    at_stations = solve(fine)
    sd = np.hypot(at_stations.sd_Nm_per_rad, np.interp(fine, twist, widened))
    rows = zip(fine, at_stations.stiffness_Nm_per_rad, sd, strict=True)
    shown = {f"at {x:+.3g} rad": (float(k), float(s), "N m/rad") for x, k, s in rows}
    return replace(form, sd_Nm_per_rad=widened, numbers=shown)


def _stations(twist: Array, count: int) -> Array:
    stations = np.linspace(twist[0], twist[-1], count)
    stations[np.argmin(np.abs(stations))] = 0.0
    return stations


def _table_at(linear: Fitted, stations: Array, twist: Array) -> tuple[Form, Callable[[Array], Form]]:
    """The table at these stations; and its curve anywhere else. The stiffness at zero twist stands for itself, the
    stations say how far K is from it there."""
    effect, problem = _table_effect(stations), linear.problem
    solution = problem.solve((*linear.solution.terms, Term(effect, {})))
    keep = np.flatnonzero(stations)

    def curve(p: Mapping[tuple[str, str], float], at: Array) -> Array:
        heights = np.zeros(len(stations))
        heights[keep] = [p[TABLE, row.name] for row in effect.amplitudes]
        return np.asarray(p[STIFFNESS] + np.interp(at, stations, heights))

    def anywhere(at: Array) -> Form:
        return form_of("table", linear, solution, curve, at)

    return anywhere(twist), anywhere


def _table_effect(stations: Array) -> Effect:
    """A spring whose stiffness is straight between stations and constant beyond them: one amplitude per station
    but that at zero, the torque of a hat of unit stiffness."""
    keep = np.flatnonzero(stations)

    def columns(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
        return np.column_stack([_hat_torque(motion.twist_rad, stations, int(i)) for i in keep]), state

    return Effect(
        name=TABLE,
        balance="torsion",
        kind="torque",
        meaning="a spring as a look-up table",
        equation=f"integral of K(phi), K straight between {', '.join(f'{at:.9g}' for at in stations)} rad",
        source="second article, stiffness mapping; de Boor (1978), A Practical Guide to Splines (hat functions)",
        amplitudes=tuple(Parameter(f"station_{i}", "N m/rad", "stiffness above that at zero twist") for i in keep),
        shapes=(),
        columns=columns,
        needs=("twist_rad",),
    )


def _hat_torque(twist: Array, stations: Array, i: int) -> Array:
    """(n,) torque of a spring whose stiffness is 1 at station i and 0 at the others, zero at zero twist."""
    heights = np.zeros(len(stations))
    heights[i] = 1.0
    steps = np.diff(stations)
    areas = np.concatenate(([0.0], np.cumsum(0.5 * (heights[1:] + heights[:-1]) * steps)))
    return np.asarray(_area(twist, stations, heights, areas) - _area(np.zeros(1), stations, heights, areas)[0])


def _area(x: Array, stations: Array, heights: Array, areas: Array) -> Array:
    """(n,) integral of the straight pieces from the first station to x; beyond the ends the last height goes on."""
    k = np.clip(np.searchsorted(stations, x, side="right") - 1, 0, len(stations) - 2)
    into = x - stations[k]
    slope = (heights[k + 1] - heights[k]) / (stations[k + 1] - stations[k])
    inside = areas[k] + heights[k] * into + 0.5 * slope * into**2
    below, above = x < stations[0], x > stations[-1]
    ends = np.where(below, heights[0] * (x - stations[0]), areas[-1] + heights[-1] * (x - stations[-1]))
    return np.asarray(np.where(below | above, ends, inside))


def _best(forms: Sequence[Form]) -> Form:
    told = [form for form in forms if _is_told(form)] or [forms[0]]
    least = min(form.nrmse for form in told)
    return next(form for form in told if form.nrmse <= (1 + SIMPLER_SHARE) * least)


def _is_told(form: Form) -> bool:
    """Whether a form is a spring, each of whose numbers the recording tells: a corner that the search lost to its
    bound has no deviation, whatever error it leaves."""
    known = all(np.isfinite(sd) for _, sd, _ in form.numbers.values())
    return known and bool(np.isfinite(form.sd_Nm_per_rad).all() and (form.stiffness_Nm_per_rad > 0).all())
