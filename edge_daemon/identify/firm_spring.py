"""A spring whose place no error of the output's angle takes.

Where little but a weight turns a joint, its twist and an error of the output's angle are one curve, and noise in the
twist would give it all to the error: on a real arm half the stiffness was left, and an eccentricity of 3 mrad +- 3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.effects.effect import Effect
from edge_daemon.effects.torque_source import of_output_angle
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import STIFFNESS, Term
from edge_daemon.motion.corrected import senses

SPRING_SHARE = 0.4
"""Stiffness times twist over the torque, rms, below which a spring is none: it was more beside a loop that never slips
and friction of nine tenths of the load."""


def least_stiffness(problem: RegressionProblem, spring: Effect) -> float:
    """Below which a spring carries too little of the torque to be one [N m/rad]."""
    twist_rad = math.sqrt(float(np.mean(problem.columns(spring, {}) ** 2)))
    return SPRING_SHARE * problem.rms / max(twist_rad, 1e-300)


def held_firm(terms: Sequence[Term], problem: RegressionProblem) -> tuple[Term, ...]:
    """The terms with a spring whose stiffness cannot fall below the least."""
    return tuple(_held(term, problem) if term.effect.name == STIFFNESS[0] else term for term in terms)


def firm(terms: Sequence[Term], problem: RegressionProblem) -> tuple[Term, ...]:
    """The same where a measured torque stands beside a curve of the output's angle; else as they are."""
    told = senses(problem.trials[0].motion) and any(of_output_angle(term.effect) for term in terms)
    return held_firm(terms, problem) if told else tuple(terms)


def _held(term: Term, problem: RegressionProblem) -> Term:
    first, *rest = term.effect.amplitudes
    lower = max(first.lower, least_stiffness(problem, term.effect))
    return replace(term, effect=replace(term.effect, amplitudes=(replace(first, lower=lower), *rest)))
