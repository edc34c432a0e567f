"""What estimates are worth: how long there was excitation, and which amplitudes are known well enough."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edge_daemon.motion.excitation import RECENT_S, Excitation
from edge_daemon.records import Array, Status

VALID_BELOW, INVALID_ABOVE = 0.05, 0.10
"""An amplitude turns valid when its doubt is below this share of the torque, and stays so up to the second."""
IDLE_S, ACTIVE_S = RECENT_S, 0.5
"""The drive is not excited after this long without excitation, and excited again after this much of it."""
LOST_S = 2.0
"""An estimate is invalid after this long without usable samples."""
REFUSED = 0.1
"""Above this share of contradicting blocks nothing that was learned is valid: one change of the gear makes less."""
PATIENCE_S, LONGEST_PATIENCE_S = 20.0, 600.0
"""So much motion may teach nothing before all is learned anew; twice as much each time, and never more than the
second."""
GROWN = 4.0
"""A motion of so many times the power of one that taught nothing may teach more from a new start: twice the twist."""


class DivergenceTimeout:
    """With a motion that tells no stiffness. Near the noise anything may be learned, and surely: once the motion has
    grown, or more is left than there is although it stands out of the noise, all should be learned anew; and now and
    then for as long as nothing is told."""

    def __init__(self) -> None:
        self._longest_s = PATIENCE_S
        self.renew(True)

    def renew(self, told: bool) -> None:
        """A stiffness is `told`, or it is too early to say."""
        self._waited_s = 0.0
        self._least_power = math.inf
        if told:
            self._longest_s = PATIENCE_S

    def ends(self, duration_s: float, power: float, left: float, noise: float) -> bool:
        """Whether this block without a stiffness is one too many: mean square of its torque, of what is left of it, and
        of what sensor noise leaves."""
        self._waited_s += duration_s
        tired = self._waited_s > self._longest_s
        if tired:
            self._longest_s = min(2 * self._longest_s, LONGEST_PATIENCE_S)
        grown = power > GROWN * self._least_power
        self._least_power = min(self._least_power, power)
        return tired or grown or left > power > GROWN * noise


class Validity:
    """Seconds with and without excitation and data, and the verdicts that follow, with hysteresis."""

    def __init__(self, amplitudes: int, warm_up_s: float) -> None:
        self._amplitudes, self._warm_up_s = amplitudes, warm_up_s
        self.start_over()

    def start_over(self) -> None:
        """Nothing was seen yet."""
        self.excited_s = 0.0
        self._idle_s = self._active_s = self._lost_s = 0.0
        self.rests = self._contradicted = False
        self.valid = np.zeros(self._amplitudes, dtype=bool)
        """(k,) which amplitudes are known well enough"""
        self.seen = self.told = np.zeros(self._amplitudes, dtype=bool)
        """(k,) of which the newest motion alone tells enough to notice a change; the same with its very newest block"""

    def missed(self, duration_s: float) -> None:
        """A block without motion."""
        self._lost_s += duration_s

    def saw(self, usable: NDArray[np.bool_], excited: bool, duration_s: float) -> None:
        """A block of motion, (n,) of which are usable."""
        share = float(np.count_nonzero(usable)) / max(len(usable), 1)
        self._lost_s = 0.0 if share > 0 else self._lost_s + duration_s
        if excited:
            self._idle_s, self._active_s = 0.0, self._active_s + duration_s
            self.excited_s += duration_s * share
        elif share > 0:  # what was not seen may have moved
            self._idle_s, self._active_s = self._idle_s + duration_s, 0.0

    @property
    def settled(self) -> bool:
        """Learned a first time, and again around what was found: from here on predictions mean something."""
        return self.excited_s >= 2 * self._warm_up_s

    @property
    def is_lost(self) -> bool:
        """Whether nothing usable has come for so long that nobody knows what the gear is now."""
        return self._lost_s > LOST_S

    def rest(self, unconfirmed: bool = False) -> None:
        """Whether the drive has been at rest for so long that this is what there is to say; it goes on until what was
        learned before is no longer `unconfirmed`."""
        goes_on = self.rests and (self._active_s < ACTIVE_S or unconfirmed)
        self.rests = self._idle_s > IDLE_S or goes_on

    def weigh(
        self, sd: Array, recent_sd: Array, trusted: NDArray[np.bool_] | bool, refused: float, excitation: Excitation
    ) -> None:
        """Which amplitudes of these (k,) sd are known well enough for the torque there is, and which of them the newest
        motion would contradict, that alone gives them `recent_sd`; the share `refused` of its blocks does."""
        share = np.sqrt(excitation.columns / excitation.torque)
        doubt, told = sd * share, recent_sd * share < VALID_BELOW / 2
        self.seen, self.told = told & self.told, told  # the first block that tells anything has yet to be borne out
        limit = np.where(self.valid, INVALID_ABOVE, VALID_BELOW)
        self._contradicted = refused >= REFUSED
        shown = excitation.columns > 0  # of what the motion never moved nothing is known
        self.valid = (doubt < limit) & shown & trusted & (not self._contradicted)

    def status(self, known: bool, learned: bool) -> Status:
        """Of an amplitude that is `known` well enough, once anything was `learned`."""
        if self.is_lost:
            return Status.INVALID
        if self.rests:
            return Status.NOT_EXCITED
        if not learned or not self.settled:
            return Status.WARMING_UP
        if self._contradicted:
            return Status.INVALID
        return Status.VALID if known else Status.NOT_EXCITED

    def error_status(self, nrmse: float) -> Status:
        """What the model error is worth: it needs a model that has learned, not one that is identified."""
        if self.is_lost:
            return Status.INVALID
        if math.isnan(nrmse):
            return Status.NOT_EXCITED if self.rests else Status.WARMING_UP
        return Status.NOT_EXCITED if self.rests else Status.VALID
