"""What an effect is: a declaration and one function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge_daemon.integrator.laws import Element, InLoop
from edge_daemon.records import Array, Motion

Balance = Literal["torsion", "drive"]
EffectKind = Literal["torque", "measurement"]
EffectState = Any
"""What an effect with memory carries from one block to the next; None at the start of a record."""

Told = Literal["stiffness", "angle", "timing", "torque", "output", "corners", "zeros"]
"""What two encoders must offer so that an effect can be told at all. `stiffness`: a twist above the noise. `angle`: an
arc minute above the noise. `timing`: instants that do not scatter more than they err. `torque`: a twist far above the
noise, at instants that carry it. `output`: the same, latched. `corners`: the same, beyond the gear's corners. `zeros`:
zeros that are known."""
Steady = Literal["", "nearly", "exactly"]
"""Whether columns of an effect can be a constant: over some motions, or always."""

Filters = Callable[[Array, Mapping[str, float]], NDArray[np.complex128]]
"""What an effect's only column makes of the output's acceleration by frequency [Hz] (n,), where it is a filter of that.
"""
Columns = Callable[[Motion, Mapping[str, float], EffectState], tuple[Array, EffectState]]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect: SI unit, bounds that physics allows, and where a search starts."""

    name: str
    unit: str
    meaning: str
    lower: float = float("-inf")
    upper: float = float("inf")
    start: float = 0.0
    scale: str = ""
    """a field of `Motion` whose rms is the unit of `grid`; empty: the parameter's own unit"""
    grid: tuple[float, ...] = ()
    """where a search for a shape parameter looks first, in units of `scale`"""
    quantity: str = ""
    """the estimate that a shape parameter is published as where it is tracked live; empty: it is held"""
    asks: str = ""
    """a field of `Motion` that a model must fill for a shape parameter to be told; empty: none"""
    choices: tuple[float, ...] = ()
    """the only values of a shape parameter that a search tries, at its end; empty: it is free"""


@dataclass(frozen=True, slots=True)
class Twin:
    """Another effect that is nearly the same function of the motion."""

    name: str
    parted_by: str = ""
    """what to change, other than the motion, so that the two come apart; empty: a motion does that"""


class Wave(NamedTuple):
    """What repeats so many times per turn of one of the angles `input`, `output` and `difference`."""

    angle: str
    order: float


@dataclass(frozen=True, slots=True)
class Effect:
    """One row of the catalogue.

    `columns(motion, shape, state)` returns an (n, k) array, one column per amplitude in the unit of the balance
    per unit of the amplitude, and the state to hand to the next block. torque = columns @ amplitudes.
    """

    name: str
    balance: Balance
    kind: EffectKind
    """`measurement`: an error of the sensors that disguises itself as torque; looked for first"""
    meaning: str
    equation: str
    source: str
    amplitudes: tuple[Parameter, ...]
    shapes: tuple[Parameter, ...]
    columns: Columns
    needs: tuple[str, ...] = ()
    """channels, or fields of `Motion`, that must have been measured"""
    tied: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """shape name -> (effect, amplitude) of the same model whose value it takes: it is never searched for"""
    refines: tuple[str, ...] = ()
    """simpler effects that this one contains as a special case: preferred unless the data insist"""

    carried: bool = False
    """whether its torque passes the gear on its way to the load"""
    loaded: bool = False
    """whether it grows with the torque that passes the gear, which the effects that are `carried` tell"""
    of_motor: bool = False
    """whether it is of the motor, as an error of its torque constant: it follows what the motor makes without it"""
    twins: tuple[Twin, ...] = ()
    """effects that it may be taken for; stated in one row of the two"""
    yields_to: tuple[str, ...] = ()
    """more usual effects, which come first where the motion gives both one shape"""
    misreads: str = ""
    """the field of `Motion` that errs, where it is an encoder and not the gear: the gear is not driven by that"""
    told_by: Told = "torque"
    """what an installation with two encoders needs for it, beside the channels in `needs`"""
    follows: str = ""
    """the field of `Motion` that its only column is, where the torque is proportional to that"""
    filters: Filters | None = None
    is_spring: bool = False
    """whether the torque depends on the twist alone"""
    steady: Steady = ""
    """whether it can be a constant: exactly, so that no other constant stands beside it, or nearly, so that it hides
    what the encoders' zeros differ by"""
    state_quantity: str = ""
    """the estimate that its memory is published as where it is tracked live"""
    in_loop: InLoop | None = None
    """the same torque as elements that a simulation carries; None where the measured motion carries it well enough"""
    factors: Callable[[Motion], Array] | None = None
    """(n, k) of a motion: what its LOADED elements are multiplied by, the first where their b is 1"""

    rubs: bool = False
    """whether it is dry friction, which builds up over the same angle as presliding beside it does"""
    is_bristles: bool = False
    """whether it is presliding of bristles, which keep their stiffness as what rubs beside them raises their level"""
    slips: tuple[float, ...] = ()
    """angles of the output over which its elements slip, one for each amplitude, over its shape `width`"""
    waves: tuple[Wave, ...] = ()
    """what its columns repeat with, the effect's own angle first; empty where it repeats with none"""
    carriers: tuple[str, ...] = ("",)
    """what its waves are multiplied by: nothing, the `direction` of the motion, the `load`, or a field of `Motion`"""
    waves_of: str = ""
    """the effect whose waves it is tried with, being another form of that; empty: waves are looked for"""
    later: tuple[Wave, ...] = ()
    """waves that its cause makes too, which a motion of less than two turns shows in no spectrum"""
    over: Callable[[tuple[Wave, ...]], Effect] | None = None
    """this effect over other waves; None where its orders are fixed by what it is"""

    @property
    def key(self) -> tuple[object, ...]:
        """What tells it from every other effect, one of its name over other waves or by another formula included."""
        return self.name, self.waves, self.equation

    @property
    def is_outside(self) -> bool:
        """Whether it stands against the gear from outside: it passes the gear, and is no inertia or a part of one."""
        return self.carried and self.filters is None and self.follows != "acceleration_out_rad_s2"

    @property
    def is_ripple(self) -> bool:
        """Whether it repeats, and is no other form of what does."""
        return bool(self.waves) and not self.waves_of

    @property
    def is_angle_error(self) -> bool:
        """Whether it errs in the angles, which takes the place of twist: of stiffness and damping of the same model."""
        return self.kind == "measurement" and set(self.tied) == {"stiffness", "damping"}

    @property
    def free_shapes(self) -> tuple[Parameter, ...]:
        """The shape parameters that a fit has to search for."""
        return tuple(row for row in self.shapes if row.name not in self.tied)

    @property
    def searched_shapes(self) -> tuple[Parameter, ...]:
        """Those of them that a search moves freely: neither chosen of a few nor fitted with the load."""
        return tuple(row for row in self.free_shapes if not row.asks and not row.choices)

    @property
    def law(self) -> tuple[Element, ...]:
        """Its elements at unit amplitudes, where a search starts; none where it is not simulated."""
        return () if self.in_loop is None else self.in_loop(self.start, [1.0] * len(self.amplitudes))

    @property
    def start(self) -> dict[str, float]:
        """Every shape parameter at the value a search starts from."""
        return {row.name: row.start for row in self.shapes}


def twin(one: Effect, other: Effect) -> Twin | None:
    """What one of two rows says of being taken for the other; None where neither does."""
    rows = [row for a, b in ((one, other), (other, one)) for row in a.twins if row.name == b.name]
    return rows[0] if rows else None
