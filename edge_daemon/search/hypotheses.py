"""What may be missing, fitted: the model plus some effects, how such hypotheses are ranked, and what may be believed.

The search over them begins on a grid (`grid_fit`), simulates in the loop what can be simulated (`simulated_ranking`)
and goes on to pairs where one effect is not enough (`pairs`); `search` runs the three.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.effects.catalogue import of_balance
from edge_daemon.effects.effect import Effect, twin
from edge_daemon.effects.presliding import builds_up
from edge_daemon.effects.torque_source import WEIGHED, of_output_angle
from edge_daemon.identify.firm_spring import SPRING_SHARE, held_firm
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import INERTIA, STIFFNESS, Solution, Term
from edge_daemon.integrator.laws import LOADED, SIGN
from edge_daemon.motion.corrected import senses
from edge_daemon.search.free_orders import offered, plain
from edge_daemon.search.thresholds import (
    HIDDEN,
    LAW_GAIN,
    LAW_SHARE,
    OPAQUE,
    PAIR_GAIN,
    STIFFER,
    UNDERCUT,
    WIDEST,
)

Progress = Callable[[str, float], None]
"""What is being tried, and how much of the work is done (0 to 1)."""
HypothesisFloor = Callable[[Solution], float]

NEAR_FLOOR = 1.25
"""At this error over the noise floor nothing is left to explain."""
UNSOLVED = 3.0
"""Dry friction is tried in the loop regardless where the best equation error is this many noise floors."""
DRY = (SIGN, LOADED)
"""The measured twist rate cannot carry the columns of these laws at all."""
INERTIA_ERROR = ("inertia_error", "inertia")
MODEL_TORQUE = ("model_torque", "gain")
LOADS = tuple(row.name for row in of_balance("drive") if row.is_outside)
"""What a joint carries beside its inertia: rarer forms of load friction wait for one of them."""
LOAD_FRICTION = tuple(row.name for row in of_balance("drive") if row.loaded and not row.waves)
"""What alone tells a steady load from a torque that never passes the gear, so that this waits for one of them."""
LEAST_KEPT, TAKEN_SHARE = 0.5, 0.2
"""Share of its gain that a model torque keeps beside what is named, but beside a load that leaves less than the latter
share of the error: a weight by the measured angle took all of it on real joints that were named one, and beside other
effects 0.85 and more was left; with a payload, of which the controller knows nothing, weight and inertia may make all
of its torque, and leave a hundredth (guess)."""
MOST_CREEP = 1.5
"""Creep reaches up to this speed over the rms, where a sixth of it is left at twice that: load friction at all speeds
seemed to creep up to 2.4 and 4 times."""
LEAST_FLOOR = 1e-9
"""Where sensors are free of noise the arithmetic's rounding is left."""
MOST_RIPPLE = 1.0
"""A single wave is ripple up to this rms over that of the torque: the torque holds all of it."""
WHOLE = 1.1
"""Inertia that swings behind the gear over that of all up to which it is a part of that (guess)."""
SLOWEST = 1.25
"""Frequency at which a load swings over the least that is looked for from which on it is one (guess)."""
RINGS_NOWHERE = math.sqrt(0.5)
"""Damping over the critical from which on a load that swings has no resonance."""
SLIP_SD = 2.0
"""Standard deviations of the encoder's noise below which an angle of presliding is not seen (guess)."""
PARAMETER_PRICE = 0.002
"""A parameter must remove this relative error to leave the order as it is; held-out blocks charge the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """The model plus some effects, fitted."""

    added: tuple[str, ...]
    solution: Solution
    floor: float
    """rms that sensor noise would leave with this solution's own stiffness: a model that explains the torque away
    needs little stiffness and must not win by hearing less of the noise"""
    identifiability: float = 1.0
    """how much of an unknown torque shows in what it leaves"""

    @property
    def rmse(self) -> float:
        """Held-out, unit of the balance."""
        return self.solution.rmse

    @property
    def level(self) -> float:
        """Held-out error over the noise floor, its part beyond the noise as large as it would show if nothing were
        taken up: how much is left to explain."""
        return shown(self.solution.rmse / self.floor, self.identifiability)

    @property
    def error(self) -> float:
        """The same in the unit of the balance: what explanations are compared by, since the floor moves with an effect
        that moves the stiffness, and one that hears more noise would seem to leave less."""
        return self.level * self.floor

    @property
    def name(self) -> str:
        """Effects joined with `+`, measurement effects first, else by name."""
        kinds = {term.effect.name: term.effect.kind for term in self.solution.terms}
        return "+".join(map(plain, sorted(self.added, key=lambda name: (kinds.get(name) != "measurement", name))))

    @property
    def parameters(self) -> int:
        """Numbers that were fitted for the added effects."""
        return sum(len(effect.amplitudes) + len(effect.free_shapes) for effect in added(self))


class DiagnosisProblem:
    """What is asked of one bench: the model as it stands, what it may lack, and what an explanation must keep to."""

    def __init__(
        self,
        regression: RegressionProblem,
        base: Solution,
        candidates: Sequence[Effect],
        floor: HypothesisFloor,
        progress: Progress,
        waiting: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        self.regression, self.floor, self.progress = regression, floor, progress
        self.waiting = dict(waiting or {})
        self.known = {effect.name: effect for effect in candidates}
        self.refined: dict[tuple[object, ...], Hypothesis] = {}
        """what was refined already, by what it was before"""
        self.most_floor = math.inf
        self.elsewhere = math.inf
        """rms that these recordings come to when their torque is read otherwise: what leaves much more is not told"""
        self.noise = 0.0
        """rms of what was heard to be noise although no floor foretold it: no floor is less"""
        self.base = self.hypothesis((), base)
        self.start = regression.state
        self.twist_rad = self._twist(base)
        self.least_stiffness = SPRING_SHARE * regression.rms / self.twist_rad
        """below which the spring carries too little of the torque to be one"""
        speed = np.concatenate([motion.velocity_out_rad_s for motion in regression.motions])
        self.speed_rad_s = math.sqrt(float(np.nanmean(speed**2)))
        self.least_slip_rad = max(map(least_slip, regression.trials))
        if STIFFNESS[0] in base.names and self.carried(self.base):
            self.most_floor = STIFFER * self.base.floor
            if senses(regression.trials[0].motion):
                self.base = replace(self.base, solution=replace(base, terms=held_firm(base.terms, regression)))

    @property
    def candidates(self) -> tuple[Effect, ...]:
        """What the model may lack, but for what waits for plainer forms."""
        return tuple(effect for name, effect in self.known.items() if name not in self.waiting)

    def yields_to(self, name: str) -> tuple[str, ...]:
        """What is more usual than an effect that looks the same: a weight, but not beside a sensor that weighs it."""
        effect = self.known[name]
        if not senses(self.regression.trials[0].motion):
            return effect.yields_to
        if name == WEIGHED:
            return (*effect.yields_to, *(twin.name for twin in effect.twins))
        return tuple(usual for usual in effect.yields_to if usual != WEIGHED)

    def plainer(self, name: str) -> set[str]:
        """What an effect refines, or is rarer than."""
        return {*self.known[name].refines, *self.yields_to(name)}

    def _twist(self, base: Solution) -> float:
        """rms of the measured twist [rad]; infinite in a balance without one."""
        if STIFFNESS[0] not in base.names:
            return math.inf
        twist = self.regression.columns(effect_of(base, STIFFNESS[0]), {})
        return math.sqrt(float(np.mean(twist**2)))

    def hypothesis(self, added: tuple[str, ...], solution: Solution, shows: float = 1.0) -> Hypothesis:
        """A solution as an explanation, its floor no more than the model's own allows, if that has a spring at all."""
        bent = any(term.effect.kind == "measurement" and term.effect.name in added for term in solution.terms)
        floor = self.within(self.floor(solution), HIDDEN / STIFFER if bent else 1.0)
        floor *= 1.0 - self._taken_for_granted(solution)
        return Hypothesis(added, solution, max(floor, LEAST_FLOOR), shows)

    def within(self, floor: float, wider: float = 1.0) -> float:
        """A noise floor between the least and the most that noise can be."""
        return min(max(floor, self.noise), self.most_floor * wider)

    def _taken_for_granted(self, solution: Solution) -> float:
        """Share of a measured torque that an inertia takes: torque is inertia times acceleration whatever the gear
        does, so that all that it leaves, noise as well, shrinks by as much and nothing is explained."""
        if INERTIA_ERROR[0] not in solution.names:
            return 0.0
        column = self.regression.columns(effect_of(solution, INERTIA_ERROR[0]), {})[:, 0]
        target = self.regression.target
        share = solution.amplitude(*INERTIA_ERROR) * float(column @ target) / max(float(target @ target), 1e-300)
        return min(max(share, 0.0), 1.0)

    def offered(self, onto: Hypothesis, to_leave: float = 1.0) -> list[Effect]:
        """The candidates, each that repeats over the orders that stand out of what a hypothesis leaves, if it may leave
        no more than a share of that."""
        return offered(self.candidates, onto.solution, self.regression, to_leave)

    def keeping(self, hypothesis: Hypothesis, names: tuple[str, ...]) -> Hypothesis:
        """A hypothesis with only these of its effects, its columns as they are."""
        terms, parts, i = [], [], 0
        for term in hypothesis.solution.terms:
            width = len(term.effect.amplitudes)
            if term.effect.name in names or term.effect.name not in hypothesis.added:
                terms.append(term)
                parts.append(hypothesis.solution.columns[:, i : i + width])
            i += width
        return self.hypothesis(names, self.regression.solution(terms, np.hstack(parts)), hypothesis.identifiability)

    def pair_gain(self, single: Hypothesis, pair: Hypothesis | None = None) -> float:
        """Error of a pair over that of the best single below which the second effect is believed: lower where what is
        left may be the roughness of a simulated law rather than another effect, unless that is steady, and where both
        are laws of the twist, of which one may only mend the other."""
        rows = [] if pair is None else [effect_of(pair.solution, name) for name in pair.added]
        steady = any(row.steady and row.name not in single.added for row in rows)
        laws = bool(rows) and all(row.in_loop for row in rows)
        return LAW_GAIN if (self.inexact(single) and not steady) or laws else PAIR_GAIN

    def inexact(self, single: Hypothesis) -> bool:
        """Whether what is left may be no more than the roughness of a simulated law."""
        return single.solution.design is not None and single.error < LAW_SHARE * self.base.error

    def simplifies(self, hypothesis: Hypothesis, other: Hypothesis) -> bool:
        """Whether it has a simpler form of one effect of another: only the loop tells the two apart."""
        less, more = set(hypothesis.added) - set(other.added), set(other.added) - set(hypothesis.added)
        return len(less) == len(more) == 1 and next(iter(less)) in self.known[next(iter(more))].refines

    def sprung(self, terms: Sequence[Term], stiffness: float) -> bool:
        """Whether the spring still carries a part of the torque, and no loop or gap is so wide that it acts as one. Of
        several elements some may be: what they lack in torque, a fit is free to put into their width."""
        narrow = all(narrowest(term) < WIDEST * self.twist_rad for term in terms)
        held = senses(self.regression.trials[0].motion) and any(of_output_angle(term.effect) for term in terms)
        return narrow and stiffness > (0.99 if held else 1.01) * self.least_stiffness

    def carried(self, hypothesis: Hypothesis) -> bool:
        """`sprung` of a hypothesis at its own stiffness; any will do in a balance without a spring, where nothing is
        called creep that lasts over all speeds, no presliding that is over within a sample or the encoder's noise, no
        ripple is larger than the torque, and no weight is named that the controller's model torque holds. What alone is
        of no size is nothing. What the model had before is not asked: without what it lacks its shapes go astray."""
        named = [term for term in hypothesis.solution.terms if term.effect.name in hypothesis.added]
        if len(named) == 1 and not hypothesis.solution.amplitudes[named[0].effect.name].any():
            return False
        speeds = [term.shapes.get("creep_speed", 0.0) for term in named]
        if max(speeds, default=0.0) > MOST_CREEP * self.speed_rad_s or self._replaced(hypothesis, named):
            return False
        if any(0.0 < slips_over(term, hypothesis.solution) < self.least_slip_rad for term in named):
            return False
        if self.ripple_rms(hypothesis) > MOST_RIPPLE * self.regression.rms or self._too_good(hypothesis):
            return False
        swinging = [term for term in named if term.effect.filters]
        if any(self.outweighs(term, hypothesis.solution) or _only_lags(term) for term in swinging):
            return False
        return self.sprung(hypothesis.solution.terms, hypothesis.solution.amplitude(*STIFFNESS, math.inf))

    def outweighs(self, swinging: Term, solution: Solution) -> bool:
        """Whether what swings is more than the whole inertia; where a model torque holds that, more than the torque."""
        inertia = float(solution.amplitudes[swinging.effect.name][0])
        if MODEL_TORQUE[0] not in solution.names or INERTIA[0] not in solution.names:
            return inertia > WHOLE * solution.amplitude(*INERTIA, math.inf)
        column = self.regression.columns(effect_of(solution, INERTIA[0]), {})
        return inertia * math.sqrt(float(np.mean(column**2))) > MOST_RIPPLE * self.regression.rms

    def _too_good(self, hypothesis: Hypothesis) -> bool:
        """Whether a law in the loop leaves far less than a torque sensor's noise."""
        in_loop = hypothesis.solution.design is not None and senses(self.regression.motions[0])
        return in_loop and hypothesis.rmse < UNDERCUT * hypothesis.floor

    def ripple_rms(self, hypothesis: Hypothesis) -> float:
        """rms of the largest single wave among the effects of a drive that a hypothesis adds: a motion that nearly
        always goes one way fits what is left by waves that cancel each other."""
        largest, i = 0.0, 0
        for term in hypothesis.solution.terms:
            stop = i + len(term.effect.amplitudes)
            if term.effect.name in hypothesis.added and term.effect.waves and term.effect.balance == "drive":
                waves = hypothesis.solution.columns[:, i:stop] * hypothesis.solution.amplitudes[term.effect.name]
                largest = max(largest, math.sqrt(float(np.mean(waves**2, axis=0).max())))
            i = stop
        return largest

    def _replaced(self, hypothesis: Hypothesis, named: Sequence[Term]) -> bool:
        """Whether what is named takes the place of the controller's model torque, or a load that of the inertia: less a
        weight, a model torque is an acceleration without noise."""
        kept = [[h.solution.amplitude(*row, 0.0) for h in (self.base, hypothesis)] for row in (MODEL_TORQUE, INERTIA)]
        (before, after), (inertia, less) = kept
        load = any(term.effect.carried for term in named)
        if before > 0.0 and after > before and less < LEAST_KEPT * inertia and load:
            return True
        return after < LEAST_KEPT * before and not (load and hypothesis.error < TAKEN_SHARE * self.base.error)

    def dry(self, hypothesis: Hypothesis) -> bool:
        """Whether the last effect added is friction that only knows the direction."""
        laws = self.known[hypothesis.added[-1]].law
        return bool(laws) and all(law.kind in DRY for law in laws)

    def awaited(self, pair: Hypothesis) -> str:
        """The plainer law of a pair, for which other forms wait than the finer one beside it: what the two take
        together another may take as well, and they are weighed once it is there. Empty where there is none."""
        rows = [self.known[name] for name in pair.added]
        if len(rows) != 2 or rows[0].balance != "drive" or not any(row.refines and not row.steady for row in rows):
            return ""
        simple = {name for row in of_balance("drive") for name in row.refines}
        return next((row.name for row in rows if row.name in simple and not row.refines), "")

    def overlap(self, effect: Effect, hypothesis: Hypothesis) -> bool:
        """Whether an effect is part of a hypothesis, or a refinement or simplification of a part; in a drive balance,
        where friction is built up, of a part that was added, or another refinement of the same, but for friction of the
        load beside what knows none, and for what rubs beside presliding."""
        names = {term.effect.name for term in hypothesis.solution.terms}
        built_up = effect.balance == "drive"
        parts = set(hypothesis.added) if built_up else names
        beside = [self.known[name] for name in parts if name in self.known]
        related = {simple for row in beside for simple in row.refines}
        forms = (row for row in beside if row.loaded == effect.loaded and not builds_up([row, effect]))
        if built_up and any(set(row.refines) & set(effect.refines) for row in forms):
            return True
        return effect.name in names | related or bool(parts & set(effect.refines))


def _only_lags(swinging: Term) -> bool:
    """Whether a load swings as slowly as a search goes, as none on a gear does, or is damped so that it rings nowhere:
    it is a lag then, or what the model torque of a controller has of the commanded motion."""
    row = next(row for row in swinging.effect.free_shapes if row.name == "frequency")
    return swinging.shapes[row.name] < SLOWEST * row.lower or swinging.shapes.get("damping", 0.0) > RINGS_NOWHERE


def narrowest(term: Term) -> float:
    """Least width of its loops or gaps [rad]; 0 where it has none."""
    rows = [row.name for row in term.effect.free_shapes if row.scale == "twist_rad"]
    return min((term.shapes.get(name, 0.0) for name in rows), default=0.0)


def slips_over(term: Term, solution: Solution) -> float:
    """Output angle [rad] over which the elements of a drive's presliding slip, by their force; 0 of what is none."""
    if not term.effect.slips:
        return 0.0
    force = solution.amplitudes[term.effect.name]
    widths = term.shapes.get("width", term.effect.start["width"]) * np.array(term.effect.slips)
    return float(force @ widths) / max(float(force.sum()), 1e-300)


def without_level(term: Term, solution: Solution) -> bool:
    """Whether nothing is left of a dry friction but what damps its bristles: that is a pulse at each reversal. A search
    may pass through it, but it is no law."""
    names = [row.name for row in term.effect.amplitudes]
    dry = "coulomb_friction" in term.effect.refines and "friction" in names
    return dry and len(names) > 1 and float(solution.amplitudes[term.effect.name][names.index("friction")]) <= 0.0


def least_slip(trial: PreparedMotion) -> float:
    """Output angle [rad] that a recording's samples and encoder resolve after a reversal."""
    acceleration = trial.motion.acceleration_out_rad_s2[trial.rows]
    within = 0.5 * math.sqrt(float(np.mean(acceleration**2))) / trial.motion.rate_hz**2
    return max(within, SLIP_SD * trial.sensors.theta_out_rad)


def shown(level: float, identifiability: float) -> float:
    """An error in noise floors with its part beyond the noise as it would show if nothing of it were taken up."""
    if identifiability < OPAQUE:
        return math.inf
    return math.sqrt(level**2 + max(level**2 - 1.0, 0.0) * (min(identifiability, 1.0) ** -2 - 1.0))


def distinct(found: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Best first, each set of effects once."""
    best: dict[frozenset[str], Hypothesis] = {}
    for hypothesis in sorted(found, key=rank):
        best.setdefault(frozenset(hypothesis.added), hypothesis)
    return list(best.values())


def rank(hypothesis: Hypothesis) -> float:
    """What to sort by: the logarithm of the held-out error, a little dearer for each parameter."""
    return math.log(max(hypothesis.error, 1e-300)) + PARAMETER_PRICE * hypothesis.parameters


def effect_of(solution: Solution, name: str) -> Effect:
    """The effect of that name in a solution."""
    return next(term.effect for term in solution.terms if term.effect.name == name)


def added(hypothesis: Hypothesis) -> list[Effect]:
    """The effects that a hypothesis adds to the model."""
    return [term.effect for term in hypothesis.solution.terms if term.effect.name in hypothesis.added]


def parted_by(one: Hypothesis, other: Hypothesis) -> str:
    """What to change where two explanations differ in two effects that no motion tells apart; empty where one does."""
    sides = ((one, other), (other, one))
    differ = [effect_of(a.solution, name) for a, b in sides for name in a.added if name not in b.added]
    fact = twin(*differ) if len(differ) == 2 else None
    return fact.parted_by if fact else ""
