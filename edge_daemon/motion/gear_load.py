"""What passes the gear to the load of a drive, and how far its friction has built up, as the amplitudes of a model tell
it while they are being learned.

Friction of the load, m |tau_load| sgn(omega), is a product of unknowns: equations are linear around amplitudes that are
known so far, in m and in all that tau_load is made of.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.effects.drive_waves import drag, lead, leads
from edge_daemon.effects.effect import Effect
from edge_daemon.effects.presliding import KnownEffect, builds_up, built_up, with_level_of_bristles
from edge_daemon.records import Array, Motion

INERTIA = "inertia"
ROUNDS = (0.7, 1.4)
"""Warm-ups after which all is learned anew with the load that was found: a load is told by all that is carried, and as
well as that is known."""
FOLLOW_EVERY_S = 1.0
"""Afterwards the load follows the newest amplitudes, so often."""
STEP = 1e-3
"""Step over the load's rms by which friction of the load is differentiated."""


class GearLoad:
    """Of one model; `rows` are its effects, their shapes and places among k amplitudes. No load is known at first."""

    def __init__(self, rows: Sequence[tuple[Effect, dict[str, float], slice]], amplitudes: int) -> None:
        self._rows, self._amplitudes = rows, amplitudes
        self.is_asked_for = any(effect.loaded or leads(effect) for effect, _, _ in rows)
        """whether any effect depends on the load"""
        self._builds_up = builds_up([effect for effect, _, _ in rows])
        self._leads = any(leads(effect) for effect, _, _ in rows)
        self.forget()

    def forget(self) -> None:
        """No load is known."""
        self.rounds, self._followed_s = 0, 0.0
        self._told: Array | None = None

    def take_up(self, rounds: int, amplitudes: Array) -> None:
        """Go on after so many rounds, with what they found."""
        self.rounds, self._told = rounds, amplitudes if rounds else None

    def is_renewed(self, amplitudes: Array, excited_s: float, warm_up_s: float) -> bool:
        """Let these amplitudes (k,) tell the load from now on, where that is due after so much motion. True where all
        is to be learned anew with it."""
        again = self.rounds < len(ROUNDS)
        due_s = warm_up_s * ROUNDS[self.rounds] if again else self._followed_s + FOLLOW_EVERY_S
        if not (self.is_asked_for or self._builds_up) or excited_s < due_s:
            return False
        self.rounds, self._followed_s, self._told = self.rounds + again, excited_s, amplitudes
        return again

    def on(self, motion: Motion) -> Motion:
        """The motion with the torques at the gear."""
        if self._told is None:
            return motion
        told = [(row, shape, self._told[at]) for row, shape, at in self._rows if row.carried]
        parts = [(row, row.columns(motion, shape, None)[0] @ a) for row, shape, a in told]
        carried = sum((part for _, part in parts), np.zeros(len(motion)))
        inertia = sum(float(a[0]) for row, _, a in told if row.name == INERTIA)
        outside = [part for row, part in parts if row.is_outside]
        external = -np.sum(outside, axis=0) if outside else None
        torques = replace(motion, transmitted_Nm=carried, motor_Nm=motion.torque_Nm, external_Nm=external)
        motors = [(row, shape, self._told[at]) for row, shape, at in self._rows if row.of_motor]
        own = sum((row.columns(torques, shape, None)[0] @ a for row, shape, a in motors), np.zeros(len(motion)))
        torques = replace(torques, motor_Nm=motion.torque_Nm - own)
        if self._leads:
            rows = [(row, shape, self._told[at]) for row, shape, at in self._rows]
            torques = replace(torques, drag_Nm=drag(motion, rows), lead=lead(motion, rows))
        torques = replace(torques, inertia_kg_m2=inertia)
        return with_level_of_bristles(torques, self._told_rows) if self._builds_up else torques

    @property
    def _told_rows(self) -> list[KnownEffect]:
        assert self._told is not None
        return [(effect, shape, self._told[place]) for effect, shape, place in self._rows]

    def rubbing(self, columns: Array, motion: Motion) -> Motion:
        """The motion with how far dry friction has built up, as (n, k) columns of what slides tell it."""
        if self._told is None or not self._builds_up:
            return motion
        parts = [columns[:, place] for _, _, place in self._rows]
        return replace(motion, built_up=built_up(motion, self._told_rows, parts))

    def followed(self, columns: Array, motion: Motion) -> tuple[Array, Array | float]:
        """(n, k) columns and (n,) torque to be added to the measured one, so that what friction of the load makes of an
        error in what is carried goes along with that, once the rounds are over: m |tau| ~ m |tau0| + m0 sgn(tau0)
        (tau - tau0)."""
        load = motion.transmitted_Nm
        if self._told is None or self.rounds < len(ROUNDS) or load is None or not load.any():
            return columns, 0.0
        step, slope = STEP * math.sqrt(float(np.mean(load**2))), np.zeros(len(load))
        further = replace(motion, transmitted_Nm=load + step)
        for effect, shape, place in self._rows:
            if effect.loaded:
                moved = effect.columns(further, shape, None)[0]
                slope += (moved - columns[:, place]) @ self._told[place] / step
        columns = columns.copy()
        for effect, _, place in self._rows:
            if effect.carried:
                columns[:, place] *= 1.0 + slope[:, None]
        return columns, slope * load

    def sd(self, columns: Array, covariance: Array) -> float:
        """Deviation (rms over (n, k) columns) of the load, where amplitudes of this (k, k) covariance tell it; 0 where
        none is asked for."""
        if not self.is_asked_for:
            return 0.0
        at = [i for effect, _, place in self._rows if effect.carried for i in range(place.start, place.stop)]
        doubt = np.einsum("ij,ij->i", columns[:, at] @ covariance[np.ix_(at, at)], columns[:, at])
        return math.sqrt(max(float(np.mean(doubt)), 0.0))

    def power_if_all_passed(self, motion: Motion) -> Array:
        """(k,) rms of what asks for the load would make per unit if the whole torque passed, or moved the inertia; 0 of
        all else."""
        power, most = np.zeros(self._amplitudes), float(np.mean(motion.torque_Nm**2))
        moved = max(float(np.mean(motion.acceleration_out_rad_s2**2)), 1e-300)
        passed = replace(motion, transmitted_Nm=motion.torque_Nm, inertia_kg_m2=math.sqrt(most / moved))
        for effect, shape, place in self._rows if self.is_asked_for else ():
            if effect.loaded or leads(effect):
                power[place] = np.sqrt(np.mean(effect.columns(passed, shape, None)[0] ** 2, axis=0))
        return power
