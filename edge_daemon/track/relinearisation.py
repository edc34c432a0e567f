"""When to learn everything anew, and around which point: stiffness times kinematic error is a product of unknowns.

After the warm-up everything is learned anew around what it found; the newest estimate is followed only after as long
again. Right after a new start the estimates are those of a block or two, and no point to linearise around.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edge_daemon.motion.regressors import DAMPING, STIFFNESS, Linearisation
from edge_daemon.records import Array
from edge_daemon.track.prior import laws_in
from edge_daemon.track.recursive import AmplitudeFilter
from edge_daemon.track.state import AmplitudeState
from edge_daemon.track.validity import REFUSED


class Schedule(NamedTuple):
    """Of one kind of model."""

    rounds: tuple[float, ...]
    """warm-ups after which to learn anew around what was found"""
    predicts_from: int
    """how many of them before the twist is predicted; more than there are: never"""
    keeps: bool = False
    """whether what the balance taught still counts then"""


BALANCE = Schedule((1.0,), 9)
CURVED = Schedule((0.6, 1.0, 1.4), 9)
"""A sign sees the kinematic error's rate in full, and only the second time around what is left of it."""
SIMULATED = Schedule((*CURVED.rounds, 2.0), 3)
"""The balance as for curved columns, and once more with the laws simulated."""
LINEAR = Schedule((1.0, 2.0), 2, keeps=True)
"""The balance again with the damping of the kinematic error in it, then what follows from the motor angle."""
HELD = 0.6
"""For so many warm-ups after the first prediction, predictions stay around what was known at it."""
STRAYED, STRAYED_SD = 0.3, 2.0
"""An amplitude may leave what a prediction was made with by this share of itself, and so many standard deviations,
before all is learned anew around what was found: a gear that was predicted with too little damping seems surer than it
is."""
MOST_AGAIN = 4
"""An estimate that does not settle in so many times is no better for more of them (guess)."""
ADEQUATE = 0.2
"""A prediction may take over below this share of the residual that sensor noise does not explain."""
DOUBTED, DOUBTED_S = 0.2, 10.0
"""After such a share for so long the prediction was not the right thing to do."""
FOLLOW_AFTER = 2.0
"""After so many warm-ups the point of linearisation follows the newest estimate."""
FOLLOW_EVERY_S = 1.0


class Relinearisation:
    """Of learning, and the point that each is linear around."""

    def __init__(self, known: AmplitudeState, warm_up_s: float, schedule: Schedule) -> None:
        self._known, self._warm_up_s, self._planned = known, warm_up_s, schedule
        self.start_over()

    def start_over(self) -> None:
        """Before the first."""
        self._schedule = self._planned
        self.count = 0
        self.followed_s = 0.0
        self.adequate = True
        """whether a prediction may take over from the balance"""
        self._doubted_s = 0.0
        self._around: Array | None = None
        self._held_until_s = 0.0
        self._again = 0

    @property
    def predicts(self) -> bool:
        """Whether the gear is known well enough to be simulated."""
        return self._known.point is not None and self.count >= self._schedule.predicts_from

    def gives_up(self, structure: float, duration_s: float, refused: float = 0.0) -> bool:
        """Whether a prediction has left the share `structure` of its residual unexplained, or the share `refused` of
        the blocks contradicted it, for so long that from now on there is none."""
        doubted = self.predicts and (structure > DOUBTED or refused > REFUSED)
        self._doubted_s = self._doubted_s + duration_s if doubted else 0.0
        if self._doubted_s < DOUBTED_S:
            return False
        self._schedule, self._doubted_s = BALANCE, 0.0
        return True

    def around(self, filt: AmplitudeFilter, excited_s: float) -> Array:
        """(k,) amplitudes that a prediction is made with."""
        held = self._around is not None and excited_s < self._held_until_s
        return self._around if held and self._around is not None else filt.value

    def let_go(self) -> None:
        """Predictions follow the newest estimates from now on."""
        self._around = None

    @property
    def holds(self) -> bool:
        """Whether predictions stay around what was known before the first of them."""
        return self._around is not None

    def _strayed(self, filt: AmplitudeFilter, around: Array) -> bool:
        """Whether predictions were held around what has turned out to be far from the gear."""
        value = filt.value
        regressors = self._known.regressors
        size = np.abs(value)
        size[regressors.shaping] = 1.0
        far = np.maximum(STRAYED * size, STRAYED_SD * filt.sd)
        spring = [i for key in (STIFFNESS, DAMPING) if (i := regressors.index(*key)) is not None]
        laws = [i for _, _, place in laws_in(regressors) for i in range(place.start, place.stop)]
        places = (*spring, *laws, *range(regressors.shaping.start, regressors.shaping.stop))
        return any(abs(value[i] - around[i]) > far[i] for i in places)

    def _follow_up(self, filt: AmplitudeFilter | None, excited_s: float) -> bool:
        """Whether the last round is due again, since it was made around what was far from the gear."""
        if self._around is None or filt is None or self._schedule.keeps or excited_s < self._held_until_s:
            return False
        around, self._around = self._around, None
        if self._again == MOST_AGAIN or not self._strayed(filt, around):
            return False
        self._again += 1
        return True

    def move(self, excited_s: float) -> bool:
        """Linearise around the newest where that is due; True when a new round begins with it."""
        filt, place = self._known.filter, self._known.regressors.kinematic
        rounds, first, keeps = self._schedule
        again = self.count < len(rounds) and (self.adequate or self.count + 1 < first)
        if not again and self._follow_up(filt, excited_s):
            again, self.count = True, len(rounds) - 1
        due_s = self._warm_up_s * (rounds[self.count] if again else FOLLOW_AFTER)
        if not again:
            due_s = max(due_s, self.followed_s + FOLLOW_EVERY_S, self._held_until_s)
        stiffness = self._known.sure_stiffness() if excited_s >= due_s else 0.0
        if filt is None or place.start == place.stop or not stiffness > 0:
            return False
        if again:
            self.count += 1
            if self.predicts:
                self._around, self._held_until_s = filt.value, excited_s + HELD * self._warm_up_s
            if not (keeps and self.predicts):
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
