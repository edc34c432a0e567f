"""Laws outside the catalogue: formulas proposed for what a model leaves, where the data insist on one.

What is left is searched for products of simple factors (`screening`, `refining`, `search`), the best are written as
expressions (`writing`), fitted with the model as `add` would, and ranked by held-out error and length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.discover.proposals import NOTHING_NAMED, Rival, proposals
from edge_daemon.discover.search import EXACT_FLOORS, MOST_PRODUCTS
from edge_daemon.discover.weighing import LEAST_GAIN, PART_BELIEF
from edge_daemon.effects.model import Model
from edge_daemon.effects.torque_source import MOTOR_SIDE
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.leaping_friction import MOST_LEFT
from edge_daemon.explain.results import Candidate, Diagnosis, Proposal, none_of
from edge_daemon.explain.verdict import believed, left_by
from edge_daemon.identify.problem import ReadyOnce
from edge_daemon.records import Recorded
from edge_daemon.search.hypotheses import LEAST_FLOOR, Progress
from edge_daemon.search.thresholds import EXPLAINED_FLOORS

LEAST_LEVEL = 1.6
"""Error over the noise floor of a model that lacks something below which no formula is looked for in what it leaves
(guess: an exact model leaves up to 1.3)."""
CERTAIN = 0.9
"""Probability of a cause from which on no formula is looked for (guess)."""
CATALOGUED_SHARE = 0.1
"""Error that the best of the catalogue leaves of a drive balance, over that before, below which nothing else is looked
for: a measured speed does not carry its reversals, while a spring near the right one leaves little and is wrong."""
RIGHT_FLOORS = 1.35
"""Error over the noise floor of the best of the catalogue, or of a model that it has nothing to add to, from which on a
formula is looked for, and told if it leaves but noise (guess: right causes leave up to 1.3)."""
NEARLY_EXACT = 1.2
"""The same over the noise floor, of a cause by which a torque is not what the recording calls it (guess: an exact model
leaves up to 1.3, most less)."""
STEPS = 3
"""Causes of a drive balance that are added in turn before a formula is held against them (guess: friction, drag and one
more)."""
OF_ANY_JOINT = {"coulomb_friction", "viscous_friction"}
"""What any joint has: the two together imitate nothing, and a formula is looked for in what they leave."""
AS_GOOD = 1.05
"""Error of a formula over that of two effects up to which it does as well, where these leave more than noise (guess):
nothing in other words than theirs is as good as what leaves noise."""
FAR_BETTER = 0.5
"""Error of a formula over that of the best of the catalogue up to which it is told beside it."""
NO_FORMULA = 0.15
"""Share of laws outside the catalogue for which no formula is found that leaves as little as causes that imitate them
(guess: of twelve laws of another hand it was one, of 58 of our own none)."""


def discover(
    recordings: Sequence[Recorded],
    model: Model,
    on_progress: Progress | None = None,
    thorough: bool = False,
) -> Diagnosis:
    """The diagnosis, with formulas for what the catalogue does not explain, be it no more than a few noise floors.
    Raises `BadInput` in one line.

    `thorough`: also where it offers a cause that leaves more than noise.
    """
    progress = on_progress or (lambda what, share: None)
    recordings = [ReadyOnce(row) for row in recordings]
    found = diagnose(recordings, model, lambda what, share: progress(what, 0.6 * share))
    if not _worth(found, model, thorough):
        return found
    with np.errstate(all="ignore"):
        rows = proposals(recordings, model, lambda what, share: progress(what, 0.6 + 0.4 * share), _rival(found))
    if found.verdict == "adequate":
        return _not_adequate(found, rows)
    if model.balance == "torsion" and _outdoes(found, rows):
        return _believed_further(found)
    reached, numbers, effects = _story(rows, recordings, model, found)
    right = reached < RIGHT_FLOORS * found.error.noise_floor_nrmse
    good = [row for row in rows if row.nrmse_after < (1.0 if right else AS_GOOD) * reached]
    shorter = [row for row in good if row.numbers < numbers and row.laws < effects]
    told = tuple(row for row in rows if row in shorter or _far_better(row, reached, found))
    return _beside(_doubted(found, rows, shorter, reached), told, shorter)


def _not_adequate(found: Diagnosis, rows: Sequence[Proposal]) -> Diagnosis:
    """The diagnosis of a model that is adequate as far as the catalogue goes, unless formulas are believed that leave
    nothing but noise of what it leaves."""
    noise = RIGHT_FLOORS * found.error.noise_floor_nrmse
    told = tuple(row for row in rows if row.nrmse_after < min(noise, LEAST_GAIN * found.error.nrmse))
    insisted = sum(row.probability for row in told) > PART_BELIEF
    return replace(found, verdict="unexplained", proposals=told) if insisted else found


def _outdoes(found: Diagnosis, rows: Sequence[Proposal]) -> bool:
    """Whether the best cause, that was not believed, takes most of what there is, and no formula as much: a law outside
    the catalogue that it only imitates would have been told by one. With one encoder what nobody believes may be that
    nothing is missing, which no formula tells either."""
    if found.verdict != "unexplained" or not found.candidates:
        return False
    least = min(row.nrmse_after for row in found.candidates)
    return least < MOST_LEFT * found.error.nrmse and all(row.nrmse_after > least for row in rows)


def _believed_further(found: Diagnosis) -> Diagnosis:
    """The diagnosis, that it is none of its causes believed only as far as such a law would have no formula."""
    whole = 1.0 - (1.0 - NO_FORMULA) * none_of(found.candidates)
    candidates = tuple(replace(row, probability=row.probability / whole) for row in found.candidates)
    if believed(candidates) < none_of(candidates):
        return replace(found, candidates=candidates)
    name, after = candidates[0].effect, candidates[0].nrmse_after
    left = left_by(name, after / found.error.nrmse, after / max(found.error.noise_floor_nrmse, LEAST_FLOOR))
    return replace(found, verdict="missing", candidates=candidates, warnings=(*found.warnings, left))


def _far_better(row: Proposal, reached: float, found: Diagnosis) -> bool:
    """Whether a formula leaves far less than the catalogue comes to, or far less that is no noise."""
    noise = min(found.error.noise_floor_nrmse, row.nrmse_after)
    beyond, own = (math.sqrt(error**2 - noise**2) for error in (max(reached, noise), row.nrmse_after))
    return row.nrmse_after < FAR_BETTER * reached or (
        reached > RIGHT_FLOORS * noise and own < FAR_BETTER * beyond and row.nrmse_after < LEAST_GAIN * reached
    )


def _doubted(found: Diagnosis, rows: Sequence[Proposal], shorter: Sequence[Proposal], reached: float) -> Diagnosis:
    """The diagnosis, its causes together believed no further than a part where a formula leaves much less than they
    come to, or than those that leave as little with fewer numbers let them: then they only imitate what is missing. One
    of more laws than these, and not believed, says that more is."""
    much_less = [row for row in rows if row.nrmse_after < LEAST_GAIN * reached]
    effects = max((len(row.effect.split("+")) for row in found.candidates[:1]), default=0)
    imitated = sum(row.probability for row in much_less) > PART_BELIEF or any(row.laws <= effects for row in much_less)
    doubt = max(sum(row.probability for row in shorter), (1.0 - PART_BELIEF) * imitated)
    share = min((1.0 - doubt) / max(sum(row.probability for row in found.candidates), 1e-300), 1.0)
    less = tuple(replace(row, probability=share * row.probability) for row in found.candidates)
    return replace(found, candidates=less)


def _beside(found: Diagnosis, told: tuple[Proposal, ...], shorter: Sequence[Proposal]) -> Diagnosis:
    """The diagnosis with formulas, the catalogue explaining nothing where those that are shorter, or do far better, are
    believed rather than it, whichever of them it is."""
    if found.verdict != "missing":
        return replace(found, proposals=told)
    first, against = found.candidates[0].nrmse_after, _against_its_name(found)
    better = [
        row
        for row in told
        if row in shorter or (row.nrmse_after < LEAST_GAIN * first if against else _far_better(row, first, found))
    ]
    outdone = sum(row.probability for row in better) > believed(found.candidates)
    return replace(found, proposals=told, verdict="unexplained" if outdone else "missing")


def _worth(found: Diagnosis, model: Model, thorough: bool) -> bool:
    """Whether the catalogue leaves something to look for."""
    floor = max(found.error.noise_floor_nrmse, LEAST_FLOOR)
    if found.error.nrmse < (RIGHT_FLOORS if found.verdict == "adequate" else LEAST_LEVEL) * floor:
        return False
    if found.verdict != "missing":
        return True
    best = found.candidates[0].nrmse_after
    against = _against_its_name(found)
    doubtful = thorough or against or found.candidates[0].probability < CERTAIN or model.balance == "drive"
    rough = CATALOGUED_SHARE * found.error.nrmse if model.balance == "drive" else 0.0
    left = best > max((NEARLY_EXACT if against else RIGHT_FLOORS) * floor, rough)
    names = found.candidates[0].effect.split("+")
    return doubtful and (left or (len(names) > 1 and not OF_ANY_JOINT.issuperset(names)))


def _against_its_name(found: Diagnosis) -> bool:
    """Whether what is told first says that a torque is another than the one that the recording calls it."""
    return found.verdict == "missing" and MOTOR_SIDE.name in found.candidates[0].effect.split("+")


def _story(
    rows: Sequence[Proposal], recordings: Sequence[Recorded], model: Model, found: Diagnosis
) -> tuple[float, int, int]:
    """Error that the catalogue comes to where it offers a cause, and with how many numbers and effects where that takes
    several: two at once, or in a drive balance, where friction is built up from simple to fine, some one by one. As
    many laws under other names are no shorter. Told only where a formula is believed that could lose by it, and where
    the diagnosis, which has looked for a whole story already, did not end far above the noise."""
    if found.verdict == "unexplained" or not found.candidates:
        return math.inf, 0, 0
    first, added = found.candidates[0], 0
    reached, numbers, before = first.nrmse_after, len(first.parameters), _laws(model)
    if _against_its_name(found):
        return reached, numbers + len(MOTOR_SIDE.amplitudes) + 1, len(first.effect.split("+")) + 1
    noise = first.nrmse_after < EXACT_FLOORS * found.error.noise_floor_nrmse
    steps = STEPS if model.balance == "drive" and not noise else 0
    rivals = [row for row in rows if row.probability > PART_BELIEF]
    all_told = first.nrmse_after > EXPLAINED_FLOORS * found.error.noise_floor_nrmse
    if steps and rivals and (all_told or all(_says_all(row, first, found) for row in rivals)):
        return reached, numbers + 1, 2
    while added < steps and any(row.nrmse_after < AS_GOOD * reached for row in rivals):
        step = diagnose(recordings, model) if added else found
        if step.verdict != "missing":
            break
        cause = step.candidates[0]
        numbers += len(cause.parameters) if added else 0
        model = step.with_first or add_effect(model, cause.effect, recordings).model
        reached, added = min(reached, cause.nrmse_after), added + 1
    told = model if added else found.with_first
    effects = _laws(told) - before if told is not None else len(first.effect.split("+"))
    return reached, numbers if effects > 1 else 0, effects


def _laws(model: Model) -> int:
    """How many laws a model holds: a ripple of several orders may imitate whatever one law does over an angle."""
    return sum(max(1, len(row.waves)) for row in model.effects)


def _says_all(row: Proposal, first: Candidate, found: Diagnosis) -> bool:
    """Whether a formula does far better than one cause and has fewer numbers than that with any other beside it."""
    shorter = row.laws < 2 and row.numbers < len(first.parameters) + 1
    return shorter and _far_better(row, first.nrmse_after, found)


def _rival(found: Diagnosis) -> Rival:
    """Where the catalogue leaves so little that no formula can do far better, only a shorter one is worth telling; one
    law that all but leaves noise, where it has nothing to add."""
    if found.verdict == "adequate":
        near = min(EXACT_FLOORS * found.error.noise_floor_nrmse, LEAST_GAIN * found.error.nrmse)
        return Rival(found.error.nrmse, 1, near)
    if found.verdict != "missing":
        return NOTHING_NAMED
    first = found.candidates[0]
    effects = len(first.effect.split("+")) + _against_its_name(found)
    noise = LEAST_GAIN * first.nrmse_after < found.error.noise_floor_nrmse
    right = first.nrmse_after < RIGHT_FLOORS * found.error.noise_floor_nrmse
    return Rival(first.nrmse_after, effects - right if noise else MOST_PRODUCTS)
