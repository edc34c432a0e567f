"""What an effect is: a declaration and one function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from edge_daemon.effects.laws import InLoop
from edge_daemon.records import Array, Motion

Balance = Literal["torsion", "drive"]
EffectKind = Literal["torque", "measurement"]
EffectState = Any
"""what an effect with memory carries from one block to the next; None at the start of a record"""

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
    in_loop: InLoop | None = None
    """the same torque as elements that a simulation carries; None where the measured motion carries it well enough"""

    waves: tuple[Wave, ...] = ()
    """what its columns repeat with, the effect's own angle first; empty where it repeats with none"""
    over: Callable[[tuple[Wave, ...]], Effect] | None = None
    """this effect over other waves; None where its orders are fixed by what it is"""

    @property
    def key(self) -> tuple[object, ...]:
        """What tells it from every other effect, one of its own name over other waves included."""
        return self.name, self.waves

    @property
    def free_shapes(self) -> tuple[Parameter, ...]:
        """The shape parameters that a fit has to search for."""
        return tuple(row for row in self.shapes if row.name not in self.tied)

    @property
    def start(self) -> dict[str, float]:
        """Every shape parameter at the value a search starts from."""
        return {row.name: row.start for row in self.shapes}
