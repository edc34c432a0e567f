"""Recordings of a simulated drive, with the truth beside them.

`simulate` makes one with named effects; `hidden` draws an effect from a seed and leaves it unnamed. Times are from 0,
angles multi-turn, in the columns of the product's recordings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.rig.drive_truth import DriveTruth, simulate_drive
from edge_daemon.rig.motion import MotorMotion
from edge_daemon.rig.simulated import Simulated, Temperature, UnknownEffect, Wanted
from edge_daemon.rig.torsion_truth import simulate_joint
from edge_daemon.rig.truths import Truth

__all__ = ["HIDDEN_CASES", "Simulated", "UnknownEffect", "hidden", "simulate"]


def simulate(
    effects: Sequence[str] = (),
    seconds: float = 30.0,
    seed: int = 0,
    rate_hz: float = 1000.0,
    bits_in: int = 17,
    bits_out: int = 24,
    motion: str | MotorMotion = "rich",
    temperature: Temperature | None = None,
    parameters: Mapping[str, float] | None = None,
    balance: str = "torsion",
    laws: Sequence[Truth | DriveTruth] = (),
) -> Simulated:
    """A recording with the named effects, all of it drawn from `seed`.

    `temperature`: constant [degC], or (start, end) of a warm-up; by default 25, or a warm-up where an effect needs
    one. `parameters` overrides what would be drawn: `inertia_kg_m2`, `stiffness_Nm_per_rad`, `damping_Nms_per_rad`,
    `ratio`, or `effect.name` as in `truth["parameters"]`. `bits_*` = 0: no quantisation, no noise. `outside`: an effect
    that no catalogue lists, `hysteresis`: one of the two kinds; `laws`: the caller's own. Raises `UnknownEffect`, and
    `BadInput` for an unknown parameter or a rate that does not divide 8 kHz.
    """
    wanted = Wanted(tuple(effects), seconds, seed, rate_hz, bits_in, bits_out, motion, temperature, parameters or {})
    if balance == "drive":
        return simulate_drive(wanted, [law for law in laws if isinstance(law, DriveTruth)])
    return simulate_joint(wanted, [law for law in laws if isinstance(law, Truth)])


HIDDEN = """none polynomial_stiffness piecewise_stiffness coulomb_friction stribeck_friction load_dependent_friction
bouc_wen_hysteresis maxwell_slip_hysteresis backlash kinematic_error mesh_stiffness gravity_load constant_load
output_viscous_friction output_coulomb_friction encoder_eccentricity encoder_skew temperature_stiffness
temperature_friction kinematic_error+coulomb_friction kinematic_error+bouc_wen_hysteresis
gravity_load+coulomb_friction encoder_skew+kinematic_error
outside_speed_wave outside_twist_times_angle outside_vibration
asymmetric_hysteresis"""
HIDDEN_CASES = tuple(tuple(case.split("+")) if case != "none" else () for case in HIDDEN.split())
"""Cases that `hidden` draws from, append-only: a seed keeps its meaning because no case moves. Left out are effects
that this balance cannot tell from another by their nature."""
EDITION_SEEDS = 10**9
"""Seeds of one edition of the cases, so that each edition has more than anybody tries."""
EDITIONS = (26, 27)
"""Number of cases that each edition draws among: seeds below `EDITION_SEEDS` are the first edition's, the next as many
the second's. Appended cases are drawn by the seeds of an edition that is appended here, never by older ones."""


def hidden(seed: int, seconds: float = 30.0, bits_out: int = 24) -> Simulated:
    """A recording with an effect that the columns do not name; `truth` does. The same seed, the same recording, in
    every version. Raises `BadInput` for a seed of no edition."""
    edition = seed // EDITION_SEEDS
    if not 0 <= edition < len(EDITIONS):
        raise BadInput(f"seed {seed}: expected 0 to {len(EDITIONS) * EDITION_SEEDS - 1}")
    rng = np.random.default_rng([seed, 0x5EA1])
    case = HIDDEN_CASES[int(rng.integers(EDITIONS[edition]))]
    return simulate(case, seconds, seed=int(rng.integers(2**31)), bits_out=bits_out)
