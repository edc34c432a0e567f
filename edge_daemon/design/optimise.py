"""The least F = w1 sigma_max + w2 delta_max + w3 V within bounds and constraints, the front, and what holds it there.

Largest stresses have kinks where the worst place changes, so that no step asks for a slope: a spread of designs, then
models of the function about the best of them (COBYQA), then a search by steps on the finer mesh that `evaluate` uses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint, minimize
from scipy.stats import qmc

from edge_daemon.design.drawing import DesignError, Drawing, drawing_of, thickness_at
from edge_daemon.design.evaluate import COARSE, Figures, figures, headline
from edge_daemon.design.limits import buckling_torque_Nm, ratcheting_torque_Nm
from edge_daemon.records import Array
from edge_daemon.text import meant

SECTIONS = {
    "flexspline": (
        *("wall_mm", "rim_thickness_mm", "rim_width_mm", "diaphragm_thickness_mm", "fillet_mm", "back_cone_deg"),
        *("length_mm", "mean_radius_mm", "hub_radius_mm"),
    ),
    "wave_generator": (
        *("radial_deflection_mm", "contact_width_mm", "force_angle_deg", "disc_eccentricity_mm"),
        "bearing_stiffness_N_per_mm3",
    ),
}
"""What may be varied."""
USUAL = {"wall_mm": 0.4, "rim_thickness_mm": 0.25, "diaphragm_thickness_mm": 0.4, "fillet_mm": 0.6}
"""Where no bounds are given, these vary by so much to both sides (guess: what a redesign may move)."""
USUAL_CONE_DEG = (0.0, 10.0)
"""Where no bounds are given, the back cone varies so (guess)."""
FINEST_STEP = 1e-3
"""A search by steps ends where they are this share of the bounds: F is then flat to far less than 1 %."""
LEAST_GAIN = 3e-4
"""A round of steps that gains less than this share of F is followed by smaller steps."""
PENALTY = 20.0
"""What a broken constraint adds, in units of F per its relative breach: more than any weight makes it worth."""
BINDS = 0.01
"""A constraint within 1 % of its limit, and a variable within 1 % of its range of a bound, hold the optimum."""
SENSITIVITY_STEP = 0.01
"""Of a variable's range, for slopes: more than the mesh's own jumps, less than a kink's distance mostly."""
IMPOSSIBLE = 1e6
"""F of a design that cannot be drawn, in units of the start's."""

AIMS = ("stress_von_mises_max_MPa", "deflection_max_mm", "volume_mm3")
"""What F weighs (article 2)."""
MOST_FRONT = 60
"""Points of a front that are told: more cannot be seen apart."""

Say = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Knob:
    """One number that may vary; `point` counts along a thickness that is given by points."""

    section: str
    key: str
    point: int | None
    lower: float
    upper: float

    @property
    def name(self) -> str:
        return self.key if self.point is None else f"{self.key}[{self.point}]"

    def of(self, document: Mapping[str, Any]) -> float | None:
        """Its value in a document; None where the file does not say it."""
        value = document[self.section].get(self.key)
        found: float | None = value if self.point is None or value is None else value[self.point][1]
        return found

    def put(self, document: dict[str, Any], value: float) -> None:
        """Sets it."""
        if self.point is None:
            document[self.section][self.key] = value
        else:
            document[self.section][self.key][self.point][1] = value


@dataclass(slots=True)
class Trial:
    """A design that was tried: what F is made of, and how far it breaks each constraint (relative, above 0 broken)."""

    values: Array
    shape: str
    fineness: float
    told: dict[str, Any] | None
    """its headline figures; None where it cannot be drawn"""
    breaches: dict[str, float]
    reason: str = ""

    @property
    def broken(self) -> float:
        return sum(max(breach, 0.0) for breach in self.breaches.values())

    @property
    def aims(self) -> tuple[float, float, float]:
        """Largest stress [MPa], deflection [mm], volume [mm3]."""
        assert self.told is not None
        stress, deflection, volume = (self.told[key] for key in AIMS)
        return stress, deflection, volume


@dataclass(slots=True)
class DesignSearch:
    """All that was tried on one design, with its weights."""

    drawing: Drawing
    say: Say
    knobs: list[Knob] = field(init=False)
    tried: list[Trial] = field(default_factory=list)
    document: dict[str, Any] = field(init=False)
    _known: dict[tuple[str, float, bytes], Trial] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.document = msgspec.to_builtins(self.drawing)
        self.knobs = knobs_of(self.drawing)

    @property
    def shapes(self) -> list[str]:
        return self.drawing.optimise.shapes or [self.drawing.wave_generator.shape]

    def values(self, share: Array) -> Array:
        """From shares of the ranges (0 to 1) to values."""
        low, high = (np.array([getattr(knob, end) for knob in self.knobs]) for end in ("lower", "upper"))
        return np.asarray(low + np.clip(share, 0.0, 1.0) * (high - low))

    def start(self) -> Array:
        """The file's own design as shares of the ranges, moved inside them."""
        shares = []
        for knob in self.knobs:
            value = knob.of(self.document)
            middle = 0.5 * (knob.lower + knob.upper)
            shares.append(((middle if value is None else value) - knob.lower) / (knob.upper - knob.lower))
        return np.asarray(np.clip(np.array(shares), 0.0, 1.0))

    def drawn(self, share: Array, shape: str) -> Drawing:
        """The design. Raises `DesignError` where it cannot be."""
        document = msgspec.json.decode(msgspec.json.encode(self.document))
        for knob, value in zip(self.knobs, self.values(share), strict=True):
            knob.put(document, float(value))
        document["wave_generator"]["shape"] = shape
        return drawing_of(document)

    def trial(self, share: Array, shape: str, fineness: float) -> Trial:
        """One design tried, or what is known of it."""
        key = (shape, fineness, np.round(share, 9).tobytes())
        if key not in self._known:
            self._known[key] = self._tried(np.asarray(share, dtype=float), shape, fineness)
            self.tried.append(self._known[key])
            self.say(f"{len(self.tried)} designs", min(len(self.tried) / self.drawing.optimise.evaluations, 0.99))
        return self._known[key]

    def _tried(self, share: Array, shape: str, fineness: float) -> Trial:
        try:
            drawing = self.drawn(share, shape)
            found = figures(drawing, fineness)
        except DesignError as error:
            return Trial(share, shape, fineness, None, {}, str(error))
        return Trial(share, shape, fineness, headline(found), breaches(found))

    def cost(self, trial: Trial, weights: Sequence[float]) -> float:
        """F, and more where a constraint is broken."""
        if trial.told is None:
            return IMPOSSIBLE
        value = objective(trial, weights)
        return value * (1.0 + PENALTY * trial.broken) if trial.broken else value


def objective(trial: Trial, weights: Sequence[float]) -> float:
    """F of a trial under other weights than the file's."""
    return sum(weight * aim for weight, aim in zip(weights, trial.aims, strict=True))


def knobs_of(drawing: Drawing) -> list[Knob]:
    """What varies, from `[optimise] bounds` or as usual. Raises `DesignError`."""
    document, found = msgspec.to_builtins(drawing), list[Knob]()
    homes = {key: section for section, keys in SECTIONS.items() for key in keys}
    for name, (low, high) in (drawing.optimise.bounds or _usual(document)).items():
        key = name.rsplit(".", 1)[-1]
        if key not in homes:
            raise DesignError(f"optimise.bounds.{name}: {meant(key, homes)}")
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise DesignError(f"optimise.bounds.{name}: [{low:g}, {high:g}]: expected a lower and a higher bound")
        value = document[homes[key]].get(key)
        points = range(len(value)) if isinstance(value, list) else (None,)
        found += [Knob(homes[key], key, point, low, high) for point in points]
    return found


def _usual(document: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Bounds about the file's own design."""
    body, bounds = document["flexspline"], dict[str, tuple[float, float]]()
    for key, share in USUAL.items():
        value = body.get(key)
        if value is None:
            continue
        sizes = [row[1] for row in value] if isinstance(value, list) else [value]
        bounds[key] = (min(sizes) * (1.0 - share), max(sizes) * (1.0 + share))
    if body["kind"] != "pancake":
        bounds["back_cone_deg"] = USUAL_CONE_DEG
    return bounds


def breaches(found: Figures) -> dict[str, float]:
    """By how much each constraint of the file is broken, relative; below 0 is room."""
    drawing, solved = found.solved.drawing, found.solved
    wishes, body = drawing.optimise, drawing.flexspline
    rows = {
        "safety_min": (wishes.safety_min, found.stresses.critical.safety),
        "stiffness_min_Nm_per_rad": (wishes.stiffness_min_Nm_per_rad, solved.stiffness_Nm_per_rad),
        "wall_min_mm": (wishes.wall_min_mm, _thinnest_mm(drawing)),
        "ratcheting_min_Nm": (wishes.ratcheting_min_Nm, ratcheting_torque_Nm(solved) if drawing.teeth else math.nan),
        "buckling_min_Nm": (wishes.buckling_min_Nm, buckling_torque_Nm(solved)),
    }
    found_breaches = {name: 1.0 - has / least for name, (least, has) in rows.items() if least and not math.isnan(has)}
    if wishes.volume_max_mm3:
        found_breaches["volume_max_mm3"] = solved.volume_m3 * 1e9 / wishes.volume_max_mm3 - 1.0
    if drawing.teeth and body.kind != "pancake" and wishes.assembly:
        found_breaches["assembly"] = _assembly(found)
    return found_breaches


def _thinnest_mm(drawing: Drawing) -> float:
    body = drawing.flexspline
    walls = [body.rim_thickness_mm]
    for profile, last in ((body.wall_mm, body.length_mm), (body.diaphragm_thickness_mm, body.mean_radius_mm)):
        if profile is not None:
            walls += [thickness_at(profile, last * k / 50) for k in range(51)]
    return min(walls)


def _assembly(found: Figures) -> float:
    """Teeth at the minor axis must stand clear of each other: how far they do not, in modules."""
    from edge_daemon.design.teeth import engagement

    met = engagement(found.solved)
    return float(met.depth_m[-1] / met.module_m) if met else -1.0


@dataclass(frozen=True, slots=True)
class Optimum:
    """What a search found."""

    search: DesignSearch
    begin: Trial
    best: Trial
    front: list[Trial]

    def drawing(self) -> Drawing:
        return self.search.drawn(self.best.values, self.best.shape)


def optimise(drawing: Drawing, say: Say) -> Optimum:
    """The best design. Raises `DesignError` where none within the bounds keeps the constraints, with the reason."""
    search, wishes = DesignSearch(drawing, say), drawing.optimise
    begin = search.trial(search.start(), drawing.wave_generator.shape, 1.0)
    _spread(search)
    best = _closest(search, wishes.weights)
    if best.told is None:
        raise DesignError(f"no design within the bounds can be made: {best.reason}")
    best = _polished(search, best, wishes.weights)
    if best.broken > 1e-3:
        worst = max(best.breaches, key=lambda name: best.breaches[name])
        raise DesignError(
            f"no design within the bounds keeps optimise.{worst}: the nearest misses it by {best.breaches[worst]:.1%}"
        )
    front = _front(search)
    say("done", 1.0)
    return Optimum(search, begin, best, front)


def _spread(search: DesignSearch) -> None:
    """Designs spread over the bounds, each shape of its own."""
    count = 8 * len(search.knobs) + 8
    for shape in search.shapes:
        points = qmc.Sobol(len(search.knobs), seed=1).random(1 << math.ceil(math.log2(count)))[:count]
        for share in [search.start(), *points]:
            search.trial(share, shape, COARSE)


def _closest(search: DesignSearch, weights: Sequence[float], rounds: int = 40) -> Trial:
    """COBYQA about the two best of the spread, as far apart as they are."""
    ranked = sorted(search.tried, key=lambda trial: search.cost(trial, weights))
    starts = [ranked[0], next((t for t in ranked if np.abs(t.values - ranked[0].values).max() > 0.3), ranked[-1])]
    for start in starts:
        _modelled(search, start, weights, rounds + 10 * len(search.knobs))
    return min(search.tried, key=lambda trial: search.cost(trial, weights))


def _modelled(
    search: DesignSearch,
    start: Trial,
    weights: Sequence[float],
    rounds: int,
    radius: float = 0.15,
    fineness: float = COARSE,
) -> None:
    """COBYQA (Ragonneau 2022) from one design, with the constraints that it can tell as constraints."""
    scale, size = max(search.cost(start, weights), 1e-12), len(search.knobs)
    names = sorted(start.breaches)

    def cost(share: Array) -> float:
        trial = search.trial(share, start.shape, fineness)
        return objective(trial, weights) / scale if trial.told else 10.0

    def held(share: Array) -> Array:
        known = search.trial(share, start.shape, fineness).breaches
        return np.array([known.get(name, 1.0) for name in names])

    minimize(
        cost,
        start.values,
        method="COBYQA",
        bounds=Bounds(np.zeros(size), np.ones(size)),
        constraints=[NonlinearConstraint(held, -np.inf, 0.0)] if names else [],
        options={"maxfev": rounds, "initial_tr_radius": radius, "final_tr_radius": FINEST_STEP},
    )


def _polished(search: DesignSearch, best: Trial, weights: Sequence[float]) -> Trial:
    """On the fine mesh: steps along each variable, models of the function about what they reach, and steps again."""
    here = _stepped(search, search.trial(best.values, best.shape, 1.0), weights, 0.08)
    _modelled(search, here, weights, 12 * len(search.knobs), 0.05, 1.0)
    fine = [trial for trial in search.tried if trial.shape == here.shape and trial.fineness == 1.0]
    return _stepped(search, min(fine, key=lambda trial: search.cost(trial, weights)), weights, 0.01)


def _stepped(search: DesignSearch, here: Trial, weights: Sequence[float], step: float) -> Trial:
    """Steps along each variable and along what was gained, made smaller until they gain nothing."""
    while step > FINEST_STEP:
        before = here
        for k in range(len(search.knobs)):
            for sign in (1.0, -1.0):
                there = here.values.copy()
                there[k] = min(max(there[k] + sign * step, 0.0), 1.0)
                here = min(here, search.trial(there, here.shape, 1.0), key=lambda t: search.cost(t, weights))
        if search.cost(here, weights) > (1.0 - LEAST_GAIN) * search.cost(before, weights):
            step *= 0.3
            continue
        along = search.trial(np.clip(2 * here.values - before.values, 0.0, 1.0), here.shape, 1.0)
        here = min(here, along, key=lambda t: search.cost(t, weights))
    return here


def _front(search: DesignSearch) -> list[Trial]:
    """Designs of which none is better in stress, deflection and volume at once; searched under other weights."""
    kept = [t for t in search.tried if t.told and t.broken <= 1e-3 and t.fineness == COARSE]
    if not kept:
        return []
    span = np.maximum(np.ptp([t.aims for t in kept], axis=0), 1e-12)
    for corner in _corners(search.drawing.optimise.front_points):
        weights = corner / span
        ranked = sorted(kept, key=lambda t: float(weights @ np.array(t.aims)))
        _modelled(search, ranked[0], tuple(weights), 12 + 4 * len(search.knobs))
    kept = [t for t in search.tried if t.told and t.broken <= 1e-3 and t.fineness == COARSE]
    front = sorted(not_beaten(kept), key=lambda t: t.aims)
    return [front[k] for k in np.unique(np.linspace(0, len(front) - 1, MOST_FRONT).astype(int))]


def _corners(count: int) -> list[Array]:
    """Weights spread over a triangle, its corners first."""
    rows = [(8, 1, 1), (1, 8, 1), (1, 1, 8), (1, 1, 1), (4, 4, 1), (4, 1, 4), (1, 4, 4), (2, 1, 1), (1, 2, 1)]
    extra = np.random.default_rng(2).dirichlet((1, 1, 1), max(0, count - len(rows))).tolist()
    return [np.array(row, dtype=float) / sum(row) for row in [*rows, *extra][:count]]


def not_beaten(trials: Sequence[Trial]) -> list[Trial]:
    """Those that no other equals or beats in all three aims."""
    aims = np.array([trial.aims for trial in trials])
    found = []
    for k, own in enumerate(aims):
        beaten = (aims <= own).all(axis=1) & (aims < own).any(axis=1)
        if not beaten.any() and not (aims[:k] == own).all(axis=1).any():
            found.append(trials[k])
    return found


def document_of(found: Optimum) -> dict[str, Any]:
    """The JSON of `design optimise`."""
    search, best = found.search, found.best
    sensitivity = sensitivities(search, best)
    values = search.values(best.values).tolist()
    return {
        "best": best.told,
        "start": found.begin.told,
        "start_refused": found.begin.reason or None,
        "start_breaks": [name for name, breach in found.begin.breaches.items() if breach > 0.0],
        "weights": list(search.drawing.optimise.weights),
        "shape": best.shape,
        "variables": [
            {
                "name": knob.name,
                "value": value,
                "start": knob.of(search.document),
                "lower": knob.lower,
                "upper": knob.upper,
                "change_per_percent": sensitivity[knob.name],
            }
            for knob, value in zip(search.knobs, values, strict=True)
        ],
        "binding": binding(search, best),
        "constraints": {name: -breach for name, breach in best.breaches.items()},
        "front": [_point(search, trial) for trial in found.front],
        "evaluations": len(search.tried),
    }


def _point(search: DesignSearch, trial: Trial) -> dict[str, Any]:
    return {
        **dict(zip(AIMS, trial.aims, strict=True)),
        "shape": trial.shape,
        **{knob.name: value for knob, value in zip(search.knobs, search.values(trial.values).tolist(), strict=True)},
    }


def binding(search: DesignSearch, best: Trial) -> list[str]:
    """Constraints and bounds that hold the optimum where it is."""
    held = [name for name, breach in best.breaches.items() if breach > -BINDS]
    for knob, share in zip(search.knobs, best.values, strict=True):
        if share < BINDS or share > 1.0 - BINDS:
            held.append(f"{knob.name} at its {'lower' if share < BINDS else 'upper'} bound")
    return held


def sensitivities(search: DesignSearch, best: Trial) -> dict[str, dict[str, float]]:
    """Percent of stress, deflection, volume and F per percent of a variable's range, by variable."""
    weights = search.drawing.optimise.weights
    rows = {}
    for k, knob in enumerate(search.knobs):
        ends = []
        for sign in (-1.0, 1.0):
            share = best.values.copy()
            share[k] = min(max(share[k] + sign * SENSITIVITY_STEP, 0.0), 1.0)
            ends.append(search.trial(share, best.shape, 1.0))
        width = 100.0 * float(ends[1].values[k] - ends[0].values[k])
        if any(end.told is None for end in ends):
            rows[knob.name] = dict.fromkeys(("stress", "deflection", "volume", "objective"), math.nan)
            continue
        logs = [[*np.log(end.aims), math.log(objective(end, weights))] for end in ends]
        slopes = (100.0 * (np.array(logs[1]) - np.array(logs[0])) / width).tolist()
        rows[knob.name] = dict(zip(("stress", "deflection", "volume", "objective"), slopes, strict=True))
    return rows
