"""When to learn everything anew, and around which point: stiffness times kinematic error is a product of unknowns.

After the warm-up everything is learned anew around what it found; the newest estimate is followed only after as long
again. Right after a new start the estimates are those of a block or two, and no point to linearise around.
"""

from __future__ import annotations

import numpy as np

from edge_daemon.estimate.known import Known
from edge_daemon.estimate.prediction import DAMPING
from edge_daemon.estimate.recursive import AmplitudeFilter
from edge_daemon.estimate.regressors import Linearisation
from edge_daemon.records import Array

DRY_ROUND = 2.0
"""and once more with friction simulated, where that can be"""
HELD = 0.6
"""warm-ups after such a start during which predictions stay around what was known at it"""
LINEAR_ROUNDS, CURVED_ROUNDS = (1.0,), (0.6, 1.0, 1.4)
"""warm-ups after which to learn anew around what was found; a sign sees the kinematic error's rate in full, and only
the second time around what is left of it"""
FOLLOW_AFTER = 2.0
"""warm-ups after which the point of linearisation follows the newest estimate"""
FOLLOW_EVERY_S = 1.0


class Rounds:
    """Of learning, and the point that each is linear around."""

    def __init__(self, known: Known, warm_up_s: float, curved: bool, dry: bool) -> None:
        """`curved`: some columns are not linear in the motion; `dry`: the twist can be predicted through friction."""
        self._known, self._warm_up_s, self._dry = known, warm_up_s, dry
        rounds = CURVED_ROUNDS if curved or dry else LINEAR_ROUNDS
        self._due: tuple[float, ...] = (*rounds, *(DRY_ROUND,) * dry)
        self.start_over()

    def start_over(self) -> None:
        """Before the first."""
        self.count = 0
        self.followed_s = 0.0
        self._around: Array | None = None
        self._held_until_s = 0.0

    @property
    def predicts(self) -> bool:
        """Whether the gear is known well enough to be simulated."""
        return self._dry and self._known.point is not None and self.count >= len(CURVED_ROUNDS)

    def around(self, filt: AmplitudeFilter, excited_s: float) -> Array:
        """(k,) amplitudes that a prediction is made with."""
        held = self._around is not None and excited_s < self._held_until_s
        return self._around if held and self._around is not None else filt.value

    def move(self, excited_s: float) -> bool:
        """Linearise around the newest where that is due; True when a new round begins with it."""
        filt, place = self._known.filter, self._known.regressors.kinematic
        again = self.count < len(self._due)
        due_s = self._warm_up_s * (self._due[self.count] if again else FOLLOW_AFTER)
        due_s = max(due_s, self.followed_s + FOLLOW_EVERY_S * (not again))
        stiffness = self._known.sure_stiffness() if excited_s >= due_s else 0.0
        if filt is None or place.start == place.stop or not stiffness > 0:
            return False
        if again:
            self.count += 1
            if self.predicts:
                self._around, self._held_until_s = filt.value, excited_s + HELD * self._warm_up_s
            filt.forget(np.ones(len(filt.value)))
        self._linearise(filt, stiffness)
        self.followed_s = excited_s
        return again

    def _linearise(self, filt: AmplitudeFilter, stiffness: float) -> None:
        known = self._known
        damping, before = known.amplitude(DAMPING), known.point or Linearisation()
        damping_s = max(damping[0], 0.0) / stiffness if damping is not None else 0.0
        error_rad = before.whole_error(stiffness, filt.value[known.regressors.kinematic])
        known.point = Linearisation(stiffness, damping_s, error_rad, known.zero_rad(stiffness))
        filt.rebase(*known.regressors.rebasing(before, known.point))
