"""The loop closed: diagnose, make the motion that would tell most, and diagnose again with all recordings so far.

Who moves is none of its business: the guarded runner on a real drive, or a simulated gear. It ends when one cause is
left, when nothing more can be told by moving, or after so many motions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from edge_daemon.effects.model import Model
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.explain.plan import MotionLimits, richest
from edge_daemon.explain.results import Diagnosis, Experiment, Json, none_of, number
from edge_daemon.identify.problem import RICH_TONES, problem_of, tones
from edge_daemon.records import Recorded

MOST_MOTIONS = 3
"""More motions than three rarely tell more (guess)."""
LEAST_SEPARATION = 1.2
"""A motion in which the wrong explanation would err by less than a fifth more is not worth making (guess)."""


@dataclass(frozen=True, slots=True)
class Step:
    """One motion: why it was made, and what was known before and after it."""

    plan: Experiment
    before: Diagnosis
    after: Diagnosis

    @property
    def expects_bits(self) -> float:
        """What the motion tells if it does what is predicted."""
        return expected_bits(self.before, self.plan)

    @property
    def learned_bits(self) -> float:
        """By how much the doubt about the cause fell; below zero where a cause that seemed certain is none."""
        return doubt_bits(self.before) - doubt_bits(self.after)

    def to_json(self) -> Json:
        """One row of `motions`."""
        return {
            "plan": self.plan.to_json(),
            "expects_bits": number(self.expects_bits),
            "learned_bits": number(self.learned_bits),
            "before": named(self.before),
            "after": named(self.after),
        }


@dataclass(slots=True)
class ClosedLoop:
    """What is known of one gear so far, and which motion would tell more. Raises `BadInput` as `diagnose` does."""

    model: Model
    recordings: list[Recorded]
    limits: MotionLimits | None = None
    steps: list[Step] = field(default_factory=list)
    found: Diagnosis = field(init=False)

    def __post_init__(self) -> None:
        self.found = diagnose(self.recordings, self.model, limits=self.limits)

    def plan(self) -> Experiment | None:
        """A motion of many tones where all that is known comes of one; then what the diagnosis asks for; None where
        nothing more can be told by moving, or where that motion was made already."""
        problem = problem_of(self.recordings, self.model)
        if not self.steps and tones(problem.trials) < RICH_TONES:
            return richest(self.model, problem, self.limits)
        plan = self.found.next_experiment
        if plan is None or plan.needs_hands or not plan.separation > LEAST_SEPARATION:
            return None
        return None if any(plan.tones_hz == step.plan.tones_hz for step in self.steps) else plan

    def learn(self, plan: Experiment, recording: Recorded) -> Step:
        """Takes what was recorded of a planned motion, and diagnoses with all recordings so far."""
        self.recordings.append(recording)
        before, self.found = self.found, diagnose(self.recordings, self.model, limits=self.limits)
        self.steps.append(Step(plan, before, self.found))
        return self.steps[-1]

    def follow(self, move: Callable[[Experiment], Recorded], most: int = MOST_MOTIONS) -> Iterator[Step]:
        """Each motion, once it is made and diagnosed; what `move` raises ends it."""
        while len(self.steps) < most and (plan := self.plan()) is not None:
            yield self.learn(plan, move(plan))

    @property
    def ending(self) -> str:
        """Why no further motion is made, in a sentence."""
        found, plan = self.found, self.plan()
        if found.verdict == "adequate":
            return "nothing is missing: what is left is the sensors' noise"
        if plan is not None:
            still = " or ".join(plan.separates) or "what is missing"
            return f"{len(self.steps)} motions were made and {still} is still open: --most allows more"
        if found.next_experiment is not None and found.next_experiment.needs_hands:
            return f"no motion parts {' from '.join(found.next_experiment.separates)}: {found.next_experiment.motion}"
        if found.verdict == "unexplained":
            return "no effect of the catalogue removes what is left; next: edge-daemon discover"
        first = found.candidates[0]
        if first.confused_with:
            return f"no motion within the limits parts {first.effect} from {' or '.join(first.confused_with)}"
        return f"one cause is left: {first.effect}, probability {first.probability:.2f}"


def named(found: Diagnosis) -> str:
    """The answer in a word: the cause, or the verdict where none is named."""
    return found.candidates[0].effect if found.verdict == "missing" else found.verdict


def doubt_bits(found: Diagnosis) -> float:
    """How many yes-or-no answers the cause is away: the entropy of what is believed."""
    shares = [row.probability for row in found.candidates]
    return _entropy([*shares, none_of(found.candidates)]) if shares else 0.0


def expected_bits(found: Diagnosis, plan: Experiment) -> float:
    """What is told at the most where the motion parts its rivals and leaves the others as they are."""
    if not plan.separates:
        return doubt_bits(found)
    rivals = [row.probability for row in found.candidates if row.effect in plan.separates]
    whole = sum(rivals)
    return whole * _entropy([share / whole for share in rivals]) if whole > 0 else 0.0


def _entropy(shares: Sequence[float]) -> float:
    return -sum(share * math.log2(share) for share in shares if share > 0)
