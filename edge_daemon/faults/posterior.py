"""Which fault do the drifts point to? A posterior over the table's rows, over none, and over one that is not in it.

A fault moves the conditions along its signs, by a severity nobody knows, and strays from them by `BLUR`. None leaves
them where they were but for what a baseline errs by. An unknown fault moves any of them, each or not, either way. What
is not measured is left out: the posterior is wider then.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from edge_daemon.faults.table import FAULTS, KINDS, GearFault
from edge_daemon.records import Array

SEVERITIES = np.geomspace(0.5, 20.0, 24)
"""From half of what matters up to what no gear survives, each step as likely as the next."""
BLUR, LEAST_BLUR = 0.3, 0.1
"""A real fault strays from a sign by this share of it, and from none by the lesser share of its severity; a sensor that
errs strays by the lesser share of a sign, and moves nothing else (guess)."""
BASELINE = 0.2
"""After a change of season a baseline of a few weeks is off by this share of what matters, beyond its own sd, as seen
over simulated years."""
NONE, UNKNOWN = "none", "unknown"
CHANCE = {NONE: 0.9, UNKNOWN: 0.02}
"""Before a look at the drifts; the kinds share the rest equally, and rows of a kind its share (guess)."""
MOVED = 0.5
"""An unknown fault moves each condition with this chance (guess)."""
TOLD, MOST_TOLD = 0.1, 3
"""Kinds less likely than this are not told (guess), and no more than a reader can follow up."""
HELD = 0.9
"""What is left open holds the true kind of nine sick gears of ten: of 0.90 to 0.99 of those simulated apart, with five
sets of sensors (measured by the bench of faults)."""
NAMED, EVEN = 0.7, 0.5
"""A fault is named from this chance on: three names of a hundred are then wrong, of gears simulated apart (measured by
the bench of faults). Something is wrong where that is more likely than not."""
Drifts = Mapping[str, tuple[float, float]]
"""Condition -> (drift, sd), both in units of what matters of it; conditions that are not measured are absent."""


@dataclass(frozen=True, slots=True)
class FaultPosterior:
    """Probabilities that sum to one."""

    rows: Mapping[str, float]
    """by name of `FAULTS`, beside `NONE` and `UNKNOWN`"""
    kinds: Mapping[str, float]
    """the same by kind"""

    @property
    def named(self) -> str:
        """The kind that is likely enough to be named, or empty."""
        best = max(self.kinds, key=lambda kind: self.kinds[kind])
        return best if self.kinds[best] > NAMED else ""

    @property
    def finest(self) -> str:
        """The row that is likely enough to be named, or the kind."""
        best = max(self.rows, key=lambda name: self.rows[name])
        return best if self.rows[best] > NAMED else self.named

    @property
    def possible(self) -> tuple[str, ...]:
        """The kinds that what is measured leaves open, best first, none held likelier than another before the look.

        Most gears are well, so the chance of none hides a fault that no sensor here can see; this does not.
        """
        level = {kind: chance / _chance_of_kind(kind) for kind, chance in self.kinds.items()}
        order = sorted(level, key=lambda kind: -level[kind])
        sums = np.cumsum([level[kind] for kind in order])
        last = level[order[int(np.searchsorted(sums, HELD * sums[-1]))]]
        return tuple(kind for kind in order if level[kind] >= (1.0 - 1e-9) * last)

    def given_a_fault(self) -> FaultPosterior:
        """What is left where it is known that something is wrong."""
        wrong = max(1.0 - self.rows[NONE], 1e-12)
        rows, kinds = (
            {name: chance / wrong for name, chance in table.items() if name != NONE}
            for table in (self.rows, self.kinds)
        )
        return FaultPosterior(rows, kinds)

    def in_words(self) -> str:
        """The likeliest kinds with their chances and what to do about the first."""
        order = sorted(self.kinds, key=lambda kind: -self.kinds[kind])
        told = [f"{kind} ({self.kinds[kind]:.0%})" for kind in order[:MOST_TOLD] if self.kinds[kind] >= TOLD]
        if order[0] in (NONE, UNKNOWN):
            said = "no fault" if order[0] == NONE else "fits no known fault"
            return f"{said} ({self.kinds[order[0]]:.0%})" + (f", else {', '.join(told[1:])}" if told[1:] else "")
        best = max((row for row in FAULTS if row.kind == order[0]), key=lambda row: self.rows[row.name])
        sure = self.rows[best.name] > EVEN and best.name != best.kind
        return f"fits {', or '.join(told)}{f', there {best.name}' if sure else ''}: {best.advice}"


def posterior(drifts: Drifts) -> FaultPosterior:
    """The chances of all faults, of none, and of one that is not in the table."""
    return _posterior(tuple(drifts.items()))


@functools.lru_cache(maxsize=64)
def _posterior(drifts: tuple[tuple[str, tuple[float, float]], ...]) -> FaultPosterior:
    """Drifts change once a day, and are asked for with every block."""
    names = [name for name, _ in drifts]
    drift, sd = (np.array([told[i] for _, told in drifts]) for i in (0, 1))
    variance = sd**2 + BASELINE**2
    log = {NONE: float(_log_normal(drift, variance)), UNKNOWN: _unknown(drift, variance)}
    log |= {fault.name: _told_by(fault, names, drift, variance) for fault in FAULTS}
    chance = {name: np.log(_chance(name)) + value for name, value in log.items()}
    most = max(chance.values())
    weight = {name: float(np.exp(value - most)) for name, value in chance.items()}
    total = sum(weight.values())
    rows = {name: value / total for name, value in weight.items()}
    kinds = {kind: sum(rows[row.name] for row in FAULTS if row.kind == kind) for kind in KINDS}
    return FaultPosterior(rows, {NONE: rows[NONE], UNKNOWN: rows[UNKNOWN], **kinds})


def _chance(name: str) -> float:
    kind = next((row.kind for row in FAULTS if row.name == name), name)
    return _chance_of_kind(kind) / max(sum(row.kind == kind for row in FAULTS), 1)


def _chance_of_kind(kind: str) -> float:
    return CHANCE.get(kind, (1.0 - sum(CHANCE.values())) / len(KINDS))


def _told_by(fault: GearFault, names: list[str], drift: Array, variance: Array) -> float:
    """Logarithm of the chance of the drifts (n,), over all severities."""
    sign = np.array([fault.signs.get(name, 0.0) for name in names])
    ways = np.stack((sign, -sign) if fault.both_ways else (sign,))
    blur = LEAST_BLUR * np.abs(sign) if fault.exact else np.maximum(BLUR * np.abs(sign), LEAST_BLUR)
    size = SEVERITIES[:, None, None]
    return _mean_of_logs(_log_normal(drift - size * ways, variance + (size * blur) ** 2))


def _unknown(drift: Array, variance: Array) -> float:
    still = np.exp(-0.5 * drift**2 / variance) / np.sqrt(variance)
    wide = variance + SEVERITIES[:, None] ** 2
    moved = np.exp(-0.5 * drift**2 / wide) / np.sqrt(wide)
    return _mean_of_logs(np.sum(np.log((1.0 - MOVED) * still + MOVED * moved + 1e-300), axis=-1))


def _log_normal(off: Array, variance: Array) -> Array:
    """Over the last axis, the conditions."""
    return np.asarray(-0.5 * np.sum(off**2 / variance + np.log(variance), axis=-1))


def _mean_of_logs(log: Array) -> float:
    most = float(np.max(log))
    return most + float(np.log(np.mean(np.exp(log - most))))
