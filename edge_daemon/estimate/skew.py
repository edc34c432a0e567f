"""Whether the timing of the encoders carries what is read from the twist.

A skew between the encoders turns speed into twist. The part of the twist that it makes swings with the speed, as that
of every friction does: it adds itself to damping and friction, while stiffness stands across it.
"""

from __future__ import annotations

import math

from edge_daemon.effects.model import Model
from edge_daemon.estimate.budget import TIMING_SHARE
from edge_daemon.estimate.streaming import Stretch

SURE = 4.0
"""a skew of this many sd is one"""
BACK_SHARE = 0.7
"""of TIMING_SHARE, below which the timing carries again"""
EVERY_BLOCKS = 2
"""one in so many is looked at"""
KEEP = 0.95
"""of speed's and torque's power from one to the next: about ten seconds"""
MODELLED = frozenset({"encoder_skew", "output_viscous_friction"})
"""effects that take the skew out of damping and friction"""


class SkewWatch:
    """Follows the skew against what the gear is twisted by."""

    def __init__(self, model: Model) -> None:
        self._modelled = not MODELLED.isdisjoint(effect.name for effect in model.effects)
        self._speed = self._torque = 0.0
        self._blocks = 0
        self.carries = True
        """False while damping and friction cannot be told from skew"""
        self.share = 0.0
        """of the twist that the skew makes, rms over rms"""

    def update(self, stretch: Stretch | None, skew: tuple[float, float], stiffness: float) -> None:
        """`skew` [s] with sd, and `stiffness` [N m/rad], NaN while unknown."""
        self._blocks += 1
        if stretch is None or self._blocks % EVERY_BLOCKS or not stretch.valid.all():
            return
        speed, torque = stretch.motion.velocity_out_rad_s, stretch.motion.torque_Nm
        self._speed = KEEP * self._speed + float(speed @ speed)
        self._torque = KEEP * self._torque + float(torque @ torque)
        value_s, sd_s = skew
        if not stiffness > 0 or not math.isfinite(value_s) or not self._torque > 0:
            return
        self.share = abs(value_s) * stiffness * math.sqrt(self._speed / self._torque)
        limit = TIMING_SHARE if self.carries else BACK_SHARE * TIMING_SHARE
        self.carries = self._modelled or not (self.share > limit and abs(value_s) > SURE * sd_s)
