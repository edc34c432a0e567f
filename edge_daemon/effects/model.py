"""A model of one joint: which effects it is made of, and what their parameters are known to be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from edge_daemon.effects.effect import Balance, Wave
from edge_daemon.errors import BadInput


class ModelError(BadInput):
    """One line: file, key path, what is wrong, what was expected."""


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """One number of a fitted effect, in SI."""

    value: float
    sd: float = math.nan
    unit: str = "1"
    identified: bool = False
    """whether the recording it was fitted to determines it"""


@dataclass(frozen=True, slots=True)
class ModelEffect:
    """One effect of a model; without parameters it has not been fitted yet."""

    name: str
    parameters: Mapping[str, FittedParameter] = field(default_factory=dict)
    expression: str | None = None
    """a user's own effect: an expression over channel names; None for an effect of the catalogue"""
    unit: str | None = None
    """unit of the expression's result; None means that of the balance"""
    waves: tuple[Wave, ...] = ()
    """what it repeats with; empty means what the catalogue says"""

    def value(self, parameter: str, otherwise: float = math.nan) -> float:
        """The fitted value of one parameter, or `otherwise` where it is not fitted."""
        found = self.parameters.get(parameter)
        return found.value if found is not None else otherwise


@dataclass(frozen=True, slots=True)
class Version:
    """One line of a model's history."""

    change: str
    """what was done, e.g. `add coulomb_friction`"""
    recording: str
    nrmse: float
    """held-out error on that recording after the change"""


@dataclass(frozen=True, slots=True)
class Teeth:
    """How many teeth the two splines have."""

    flexspline: int
    circular: int


@dataclass(frozen=True, slots=True)
class Model:
    """What a model file says."""

    balance: Balance
    ratio: float
    output_inertia_kg_m2: float
    """NaN where it is not known (drive balance, or a torque sensor on the output)"""
    effects: tuple[ModelEffect, ...]
    lineage: tuple[Version, ...] = ()
    teeth: Teeth | None = None

    def effect(self, name: str) -> ModelEffect | None:
        """The effect of that name, None when the model does not have it."""
        return next((row for row in self.effects if row.name == name), None)

    def value(self, effect: str, parameter: str, otherwise: float = math.nan) -> float:
        """The fitted value of one parameter of one effect, or `otherwise`."""
        row = self.effect(effect)
        return row.value(parameter, otherwise) if row is not None else otherwise

    def with_effect(self, effect: ModelEffect) -> Model:
        """This model with `effect` in the place of the one of that name, or appended."""
        rows = tuple(effect if row.name == effect.name else row for row in self.effects)
        return replace(self, effects=rows if self.effect(effect.name) else (*self.effects, effect))

    def without(self, name: str) -> Model:
        """This model less one effect."""
        return replace(self, effects=tuple(row for row in self.effects if row.name != name))
