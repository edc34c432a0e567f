"""Rainflow cycles of a torque signal as it arrives (ASTM E1049-85, section 5.4.4).

Torque is rounded to `resolution_Nm`, which bounds memory: ranges fall on a grid, and an unclosed residue with ever
smaller ranges ends at one step. On the rounded series the counts are those of the batch algorithm, half cycles of the
residue included, wherever the series is cut into blocks.
"""

from __future__ import annotations

import itertools

import numpy as np

from edge_daemon.records import Array
from edge_daemon.usage.arrays import BrokenArrays, packed, unpacked

MOST_STEPS = 100_000
"""Torque beyond this many steps is held there: a wild value may not claim memory."""


class CycleCounter:
    """`update` with arrays of torque; `cycles` at any time. `state` and `restore` carry it over a restart.

    A small swing inside a large one is a cycle of its own; the large one stays whole:

    >>> counter = CycleCounter(resolution_Nm=0.5)
    >>> counter.update(np.array([0.0, 10.0, 6.0, 8.0, -10.0, 10.0, -10.0, 0.0]))
    >>> range_Nm, count = counter.cycles()
    >>> [(float(a), float(n)) for a, n in zip(range_Nm, count) if n]
    [(2.0, 1.0), (10.0, 1.0), (20.0, 1.5)]
    """

    def __init__(self, resolution_Nm: float) -> None:
        if not resolution_Nm > 0.0:
            raise ValueError(f"resolution_Nm: {resolution_Nm}: expected a positive torque")
        self.resolution_Nm = resolution_Nm
        self._halves = np.zeros(256, dtype=np.int64)
        self._stack: list[int] = []
        self._last: int | None = None
        self._rising = 0
        self.samples = 0
        self.ignored = 0

    def update(self, torque_Nm: Array) -> None:
        """Count a block (n,) [N m]. Samples that are not finite are left out and counted in `ignored`."""
        finite = np.isfinite(torque_Nm)
        if not finite.all():
            torque_Nm = torque_Nm[finite]
            self.ignored += finite.size - torque_Nm.size
        if not torque_Nm.size:
            return
        self.samples += torque_Nm.size
        steps = np.rint(np.clip(torque_Nm / self.resolution_Nm, -MOST_STEPS, MOST_STEPS)).astype(np.int64)
        turns = self._turning_points(steps)
        if turns:
            closed = _close(self._stack, turns)
            if closed:
                self._add(np.bincount(closed))

    def _turning_points(self, steps: np.ndarray[tuple[int], np.dtype[np.int64]]) -> list[int]:
        """The reversals that this block confirms, the last value being kept back until it is known to be one."""
        confirmed: list[int] = []
        if self._last is None:
            self._last = int(steps[0])
            confirmed.append(self._last)
        joined = np.concatenate(([self._last], steps))
        moves = np.diff(joined)
        moving = np.flatnonzero(moves)
        if not moving.size:
            return confirmed
        up = moves[moving] > 0
        turned = np.flatnonzero(up[1:] != up[:-1])
        if self._rising and (self._rising > 0) != bool(up[0]):
            confirmed.append(self._last)
        confirmed.extend(joined[moving[turned] + 1].tolist())
        self._rising = 1 if up[-1] else -1
        self._last = int(joined[-1])
        return confirmed

    def _add(self, counts: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        if counts.size > self._halves.size:
            grown = np.zeros(max(counts.size, 2 * self._halves.size), dtype=np.int64)
            grown[: self._halves.size] = self._halves
            self._halves = grown
        self._halves[: counts.size] += counts

    def cycles(self) -> tuple[Array, Array]:
        """(ranges [N m], counts), ascending; the residue, as the standard says, in half cycles."""
        stack = list(self._stack)
        closed: list[int] = []
        if self._last is not None and self._rising:
            closed = _close(stack, [self._last])
        closed += [abs(b - a) for a, b in itertools.pairwise(stack)]
        halves = np.bincount(closed, minlength=self._halves.size) if closed else np.zeros_like(self._halves)
        halves[: self._halves.size] += self._halves
        steps = np.flatnonzero(halves)
        return np.asarray(steps * self.resolution_Nm), np.asarray(halves[steps] / 2.0)

    def state(self) -> bytes:
        """Everything that `restore` needs."""
        return packed(
            halves=self._halves,
            stack=np.array(self._stack, dtype=np.int64),
            scalars=np.array([self._last or 0, self._last is not None, self._rising, self.samples, self.ignored]),
            resolution=np.array(self.resolution_Nm),
        )

    def restore(self, blob: bytes) -> bool:
        """True if the state was taken over; False, and nothing changed, if it is broken or of another resolution."""
        try:
            saved = unpacked(blob)
            if float(saved["resolution"]) != self.resolution_Nm:
                return False
            halves, stack, scalars = saved["halves"], saved["stack"].tolist(), saved["scalars"].tolist()
        except (BrokenArrays, KeyError, TypeError, ValueError):
            return False
        if halves.ndim != 1 or len(scalars) != 5:
            return False
        self._halves, self._stack = halves.astype(np.int64), stack
        last, known, self._rising, self.samples, self.ignored = (int(number) for number in scalars)
        self._last = last if known else None
        return True


def _close(stack: list[int], points: list[int]) -> list[int]:
    """Push reversals on the residue; the closed ranges, a full cycle as two entries and a half cycle as one."""
    closed: list[int] = []
    for point in points:
        stack.append(point)
        while len(stack) >= 3:
            before, middle = stack[-3], stack[-2]
            inner = middle - before if middle > before else before - middle
            if (point - middle if point > middle else middle - point) < inner:
                break
            closed.append(inner)
            if len(stack) == 3:
                del stack[0]
            else:
                closed.append(inner)
                del stack[-3:-1]
    return closed
