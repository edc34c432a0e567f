"""The stiffness of commissioning as another model sees it, from the motion of that time where it is still stored."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from edge_daemon.condition.gathering import Gathering
from edge_daemon.config.settings import Drive
from edge_daemon.effects.model import Model
from edge_daemon.records import Block, Estimate, Status
from edge_daemon.store.reader import StoreReader
from edge_daemon.store.schema import StoreError
from edge_daemon.track.baseline import Baseline
from edge_daemon.track.live import DriveEstimator

SPAN_S = 300.0
"""So much stored motion is looked at to either side of the instant when the reference was learned (guess: five minutes
tell a stiffness as well as an hour does, and cost a small computer little)."""
SETTLED_S = 30.0
"""A stiffness that has been valid for so long is what a model makes of the gear (guess)."""
NOT_STORED = (
    "the motion that the stiffness was commissioned with is not stored: what it lost so far is kept, and its reference "
    "is learned anew from now on"
)
"""What is said where a reference cannot be learned from the store."""


class Recommissioning:
    """Of one drive: `step` does a piece of it, so that the loop of the drive goes on meanwhile."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self._model: Model | None = None
        self._course: Iterator[Estimate | None] | None = None

    def step(self, model: Model, baseline: Baseline, store: Path) -> str:
        """What is to be told of it; empty while there is nothing. `baseline` gets the reference that was found."""
        if model is not self._model:
            self._model, at_s = model, baseline.wanted_s
            self._course = stiffness_at(self._drive, model, store, at_s) if math.isfinite(at_s) else None
        if self._course is None:
            return ""
        try:
            then = next(self._course)
        except (StopIteration, StoreError):
            self._course = None
            return NOT_STORED
        if then is None:
            return ""
        self._course = None
        if math.isnan(baseline.wanted_s):  # it took so long that another was learned
            return ""
        baseline.relearn(then)
        return (
            f"the stiffness of commissioning is {then.value:.4g} N m/rad with this model, learned from the stored "
            "motion of that time; its changes are held against that"
        )


def stiffness_at(drive: Drive, model: Model, store: Path, at_s: float) -> Iterator[Estimate | None]:
    """None for each piece of work done, then the stiffness [N m/rad] of about `at_s`; ends without one where the store
    does not tell. Raises `StoreError` where it cannot be read."""
    estimator, gathering = DriveEstimator(drive, model), Gathering()
    valid_s, newest, time_s = 0.0, None, -math.inf
    with StoreReader(store) as reader:
        for stored in reader.blocks(drive.name, at_s - SPAN_S, at_s + SPAN_S):
            for block in gathering.push(stored):
                newest, time_s = _stiffness(estimator, block), block.end_s
                if newest is not None:
                    valid_s += block.size / block.rate_hz
                if newest is not None and time_s > at_s and valid_s >= SETTLED_S:
                    yield newest
                    return
                yield None
    if newest is not None and time_s > at_s:
        yield newest


def _stiffness(estimator: DriveEstimator, block: Block) -> Estimate | None:
    """That after this block; None while it is not valid."""
    found = next((row for row in estimator.update(block) if row.name == "stiffness"), None)
    return found if found is not None and found.status is Status.VALID else None
