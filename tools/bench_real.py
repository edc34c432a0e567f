"""Real machines: what diagnosis builds up step by step, beside what an independent least squares found in them.

Reads `EDGE_DAEMON_REAL` (else `../shared/data/real`) and `EDGE_DAEMON_UR10E`; what is absent is left out. The limits
are held-out errors of that least squares and 5 % more. It did not weigh frequencies by their noise as the balance does
now, so that an error in ampere below its limit is no proof of a better model: the effects named count.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench_row import Row

from edge_daemon.discover.discover import discover
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.recordings.recording import read_recording
from edge_daemon.records import Array, Recorded

SHARED = Path(__file__).parents[2] / "shared/data"
REAL = Path(os.environ.get("EDGE_DAEMON_REAL", SHARED / "real"))
UR10E = Path(os.environ.get("EDGE_DAEMON_UR10E", SHARED / "ur10e"))
STEPS = 7
STEP_S = 15.0
TOLERANCE = 1.05


@dataclass(frozen=True, slots=True)
class Plain:
    """Columns over time, of a file without header."""

    time_s: Array
    columns: dict[str, Array]


@dataclass(frozen=True, slots=True)
class Machine:
    """One recording, what is in it and what it may leave."""

    name: str
    read: Callable[[], list[Recorded]]
    limit: float
    unit: str
    """`1`: over the rms of the measured torque; `A`: as it is"""
    named: frozenset[str]
    """`a|b`: either of them"""
    never: frozenset[str] = frozenset()
    ratio: float = 101.0
    start: tuple[str, ...] = ("inertia",)
    may: frozenset[str] = frozenset()
    """what the same drives are known for, but nobody sought here: neither right nor wrong"""


def _ur10e(joint: int) -> list[Recorded]:
    raw = np.loadtxt(UR10E / f"joint_{joint}.csv", delimiter=",")
    names = ("theta_out_rad", "velocity_out_rad_s", "current_in_A", "", "torque_model_Nm")
    columns = {name: raw[:, joint + 6 * i] for i, name in enumerate(names) if name}
    return [Plain(raw[:, 0], columns)]


def _lara() -> list[Recorded]:
    """Its torque is motor current, seen at the output: motor friction is still in it."""
    (read,) = _files("lara8_joint_3.csv")
    columns = dict(read.columns)
    columns["torque_in_Nm"] = columns.pop("torque_out_Nm") / 101.0
    return [Plain(read.time_s, columns)]


def _files(pattern: str) -> list[Recorded]:
    paths = sorted(REAL.glob(pattern))
    if not paths:
        raise FileNotFoundError(REAL / pattern)
    return [read_recording(path) for path in paths]


DRY = frozenset({"coulomb_friction", "viscous_friction"})
PRESLIDING = "hysteresis|maxwell_slip_hysteresis"
SLIPS = frozenset({"coulomb_friction|hysteresis|dahl_friction|maxwell_slip_hysteresis", "viscous_friction"})
"""Presliding of any form is dry friction and how it builds up in one."""
DRAG = frozenset({"coulomb_friction", "viscous_friction|sublinear_friction"})
LOADED = DRY | {"model_torque", "load_dependent_friction"}
CARRIED = DRY | {"model_torque|gravity_load", "load_dependent_friction|squared_load_friction"}
"""A joint that moves alone carries its own weight, so that a weight says what the controller's model torque does; and
what grows with the load may do so with its square: 0.0115 against 0.0130 of the torque on joint 2, and 0.0117 with a
weight against 0.0142 with the model torque on joint 3."""
OF_LOAD = frozenset({"model_torque", "gravity_load", "load_dependent_friction", "squared_load_friction",
                     "two_sided_load_friction"})  # fmt: skip
RIPPLE, ANY_PRESLIDING = frozenset({"wave_generator_ripple"}), frozenset(PRESLIDING.split("|"))
OF_ELBOW = OF_LOAD | RIPPLE | {"sublinear_friction"}
OF_WRIST = OF_LOAD | RIPPLE | ANY_PRESLIDING
MACHINES = (
    Machine("UR10e joint 1", lambda: _ur10e(1), 0.198, "A", DRY | {"sublinear_friction"} | RIPPLE, may=OF_LOAD),
    Machine("UR10e joint 2", lambda: _ur10e(2), 0.247, "A", CARRIED, may=OF_ELBOW),
    Machine("UR10e joint 3", lambda: _ur10e(3), 0.118, "A", CARRIED | RIPPLE, may=OF_ELBOW),
    Machine("UR10e joint 4", lambda: _ur10e(4), 0.0281, "A", SLIPS | RIPPLE, may=OF_WRIST),
    Machine("UR10e joint 5", lambda: _ur10e(5), 0.0361, "A", DRY | {PRESLIDING}, may=OF_WRIST),
    Machine("UR10e joint 6", lambda: _ur10e(6), 0.0283, "A", DRY | {PRESLIDING}, may=OF_WRIST),
    Machine("UR10e moving, joint 1", lambda: _files("ur10e_multijoint_1.csv"), 0.078, "1", DRAG | {"model_torque"},
            may=OF_ELBOW),
    Machine("UR10e moving, joint 2", lambda: _files("ur10e_multijoint_2.csv"), 0.027, "1", LOADED, may=OF_ELBOW),
    Machine("UR10e moving, joint 3", lambda: _files("ur10e_multijoint_3.csv"), 0.039, "1", LOADED, may=OF_ELBOW),
    Machine("Kinova joint 7", lambda: _files("kinova_gen3_joint_7_at_*.csv"), 0.0583, "1", DRY | RIPPLE, ratio=100.0,
            may=frozenset({"constant_torque", "gravity_load"})),
    Machine("OpenArm joint 2", lambda: _files("openarm_joint_2.csv"), math.nan, "1", frozenset({"coulomb_friction"}),
            RIPPLE, 10.0, may=ANY_PRESLIDING | {"gravity_load", "stribeck_friction"}),
    Machine("LARA 8 joint 3", _lara, math.nan, "1", frozenset({"encoder_eccentricity"}),
            frozenset({"gravity_load", "encoder_skew"}), start=("linear_stiffness", "viscous_damping")),
)  # fmt: skip


def story(machine: Machine) -> tuple[float, list[str], str, float]:
    """Error at the end, effects, the last verdict, and the longest step in seconds of processor time."""
    recordings = machine.read()
    balance = "drive" if "inertia" in machine.start else "torsion"
    model, longest = Model(balance, machine.ratio, math.nan, tuple(map(ModelEffect, machine.start))), 0.0
    for _ in range(STEPS):
        began = time.process_time()
        found = discover(recordings, model)
        longest = max(longest, time.process_time() - began)
        if found.verdict != "missing":
            break
        began = time.process_time()
        model = add_effect(model, found.candidates[0].effect, recordings).model
        longest = max(longest, time.process_time() - began)
    error = found.error.rmse if machine.unit == "A" else found.error.nrmse
    return error, [row.name for row in model.effects], found.verdict, longest


def _rows(machine: Machine) -> list[Row]:
    try:
        error, names, verdict, longest = story(machine)
    except FileNotFoundError:
        return []
    lacking = {name for name in machine.named if set(names).isdisjoint(name.split("|"))}
    wrong = machine.never & set(names)
    told = f"{verdict}; {' '.join(names)}" + (f"; lacks {' '.join(sorted(lacking))}" if lacking else "")
    return [
        Row(f"{machine.name}, held-out error", error, machine.unit, TOLERANCE * machine.limit, peer=told),
        Row(f"{machine.name}, effects lacking or wrong", len(lacking) + len(wrong), "1", 0.0),
        Row(f"{machine.name}, longest step", longest, "s", STEP_S),
    ]


def rows() -> list[Row]:
    """All machines that are present."""
    return [row for machine in MACHINES for row in _rows(machine)]
