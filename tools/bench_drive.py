"""How well diagnosis names what one encoder and the motor's torque show, on joints that share nothing with the product.

The model begins with inertia, viscous and Coulomb friction and weight; each case hides one thing more, or nothing.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import replace

import numpy as np
from bench_row import Row

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.identify.fit import fit
from tests.explain.simulated_drives import PLAIN_SENSING, RATIO, Arm, Sensing, record

KNOWN = ("inertia", "viscous_friction", "coulomb_friction", "gravity_load")
PLAIN = Arm(weight_Nm=12.0)
M3_100 = {"motor": 0.148, "load": 0.148}
M6_100 = {"motor": 0.049, "creep": 0.051, "driving": 0.0027, "backdriven": 0.0026}
M3_50 = {"motor": 0.063, "load": 0.063}
M6_50 = {"motor": 0.036, "creep": 0.041, "driving": 0.0016, "backdriven": 0.0019}
OF_BOTH_SIDES = ("two_sided_load_friction", "load_dependent_friction")
OF_CREEP = (*OF_BOTH_SIDES, "creep_load_friction", "squared_load_friction")
"""What names the friction of an actuator by M3, and by M6."""
BOLD = 0.5
"""Probability from which a wrong name counts as bold."""
ADEQUATE_FLOORS = 1.5
CASES: dict[str, tuple[Arm, tuple[str, ...]]] = {
    "nothing": (PLAIN, ()),
    "constant torque": (replace(PLAIN, offset_Nm=0.6), ("constant_torque",)),
    "asymmetry": (replace(PLAIN, asymmetry_Nm=1.0), ("constant_torque", "asymmetric_friction")),
    "load friction of 7 %": (replace(PLAIN, mesh=0.07), ("load_dependent_friction",)),
    "load friction of 4 %": (replace(PLAIN, mesh=0.04), ("load_dependent_friction",)),
    "ripple of 3 % on the input": (replace(PLAIN, waves=(("in", 2.0, 0.3, 0.4),)), ("wave_generator_ripple",)),
    "ripple of 6 % on the input": (replace(PLAIN, waves=(("in", 1.0, 0.6, 1.4),)), ("wave_generator_ripple",)),
    "root of speed": (replace(PLAIN, root_Nm=2.0), ("sublinear_friction",)),
    "square of speed": (replace(PLAIN, root_Nm=3.0, root_exponent=2.0), ("superlinear_friction",)),
    "Stribeck": (replace(PLAIN, stribeck_Nm=2.5), ("stribeck_friction",)),
    "temperature": (replace(PLAIN, warmth_Nms_per_K=-0.12), ("temperature_friction",)),
    "presliding": (replace(PLAIN, bristle_rad=(4e-3,)), ("hysteresis", "maxwell_slip_hysteresis")),
    "presliding of three elements": (
        replace(PLAIN, bristle_rad=(1e-3, 6e-3, 3e-2)),
        ("maxwell_slip_hysteresis", "hysteresis"),
    ),
    "load friction without the rotor": (replace(PLAIN, mesh=0.07, rotor=0.4), ("load_dependent_friction",)),
    "bristles of LuGre": (
        replace(PLAIN, stribeck_Nm=2.5, bristles=(3000.0, 40.0)),
        ("lugre_friction",),
    ),
    "ripple that grows with speed": (replace(PLAIN, drag=((2.0, 0.5, 0.4),)), ("speed_ripple",)),
    "kinematic error": (replace(PLAIN, rotor=0.4, error=(2.0, 1e-5, 0.7)), ("kinematic_error",)),
    "actuator M3, 100": (
        replace(PLAIN, coulomb_Nm=4.83, viscous_Nms=7.4, actuator=M3_100),
        OF_BOTH_SIDES,
    ),
    "actuator M3, 50": (
        replace(PLAIN, coulomb_Nm=3.47, viscous_Nms=1.21, actuator=M3_50),
        OF_BOTH_SIDES,
    ),
    "actuator M6, 50": (
        replace(PLAIN, coulomb_Nm=3.26, viscous_Nms=1.4, stribeck_Nm=0.32, stribeck_rad_s=2.83,
                stribeck_exponent=1.79, actuator=M6_50),
        OF_CREEP,
    ),
}  # fmt: skip
ROBOT = Sensing(rate_hz=125.0, bits=19, noise=0.02, step=0.01, jitter=0.2, velocity_rad_s=2e-4)
SERVO = Sensing(rate_hz=1000.0, bits=17, noise=0.005, memory_s=0.003)
BUS = Sensing(rate_hz=200.0, bits=16, noise=0.01, step=0.02, jitter=0.3, lost=0.02)
COARSE = Sensing(rate_hz=100.0, bits=12, noise=0.02, step=0.03)
FINE = Sensing(rate_hz=300.0, bits=24, noise=0.002, jitter=0.05)
SLOW = Sensing(rate_hz=64.0, bits=18, noise=0.01, velocity_rad_s=1e-3, pace=0.5)
VARIED: dict[str, tuple[Sensing, Arm, tuple[str, ...]]] = {
    "robot: nothing": (ROBOT, PLAIN, ()),
    "robot: root of speed and ripple": (
        ROBOT,
        replace(PLAIN, coulomb_Nm=3.0, root_Nm=4.0, waves=(("between", 2.0, 0.5, 0.3),)),
        ("sublinear_friction", "wave_generator_ripple"),
    ),
    "robot: Stribeck": (ROBOT, replace(PLAIN, stribeck_Nm=3.0, stribeck_rad_s=0.15), ("stribeck_friction",)),
    "servo: ripple of 7 and 12": (
        SERVO,
        replace(PLAIN, waves=(("in", 7.0, 0.4, 1.0), ("in", 12.0, 0.3, 2.0))),
        ("wave_generator_ripple",),
    ),
    "servo: presliding": (
        SERVO,
        replace(PLAIN, bristle_rad=(2e-3, 8e-3)),
        ("hysteresis", "maxwell_slip_hysteresis"),
    ),
    "bus: actuator M3, 50": (
        BUS,
        replace(PLAIN, weight_Nm=25.0, coulomb_Nm=3.47, viscous_Nms=1.21, actuator=M3_50),
        OF_BOTH_SIDES,
    ),
    "bus: presliding": (BUS, replace(PLAIN, bristle_rad=(3e-3, 2e-2)), ("hysteresis", "maxwell_slip_hysteresis")),
    "bus: nothing": (BUS, replace(PLAIN, weight_Nm=30.0), ()),
    "coarse: constant torque": (COARSE, replace(PLAIN, offset_Nm=1.5), ("constant_torque",)),
    "coarse: nothing": (COARSE, PLAIN, ()),
    "fine: temperature and ripple": (
        FINE,
        replace(PLAIN, warmth_Nms_per_K=-0.15, waves=(("out", 6.0, 0.5, 0.1),)),
        ("temperature_friction", "wave_generator_ripple"),
    ),
    "fine: ripple between": (FINE, replace(PLAIN, waves=(("between", 3.0, 0.3, 0.4),)), ("wave_generator_ripple",)),
    "slow: load friction": (SLOW, replace(PLAIN, mesh=0.07, weight_Nm=30.0), ("load_dependent_friction",)),
    "slow: actuator M6, 100": (
        SLOW,
        replace(PLAIN, weight_Nm=40.0, coulomb_Nm=0.0005, viscous_Nms=9.7, stribeck_Nm=5.23, stribeck_rad_s=2.03,
                stribeck_exponent=3.0, actuator=M6_100),
        (*OF_CREEP, "stribeck_friction", "sublinear_friction"),
    ),
}  # fmt: skip
"""The same read by sensors of other kinds: rates of 64 to 1000 Hz, 12 to 24 bits, jitter, lost samples, currents that
are rounded or hum."""
DRAWN = 40
"""Joints that are drawn for the figures."""


def drawn(i: int) -> tuple[Sensing, Arm, tuple[str, ...], str]:
    """The joint of a number: machine, sensors and what is hidden, all drawn; names that are right, and in words."""
    rng = np.random.default_rng([i, 0xD21])
    level = float(rng.uniform(2.0, 8.0))
    arm = Arm(
        inertia_kg_m2=float(rng.uniform(0.3, 2.0)), weight_Nm=float(rng.choice([0.0, 10.0, 20.0, 40.0])),
        viscous_Nms=float(rng.uniform(1.0, 10.0)), coulomb_Nm=level,
    )  # fmt: skip
    sensing = Sensing(
        rate_hz=float(rng.choice([100.0, 125.0, 250.0, 500.0, 1000.0])), bits=int(rng.choice([14, 16, 18, 20, 23])),
        noise=float(rng.choice([2e-3, 5e-3, 1e-2, 2e-2])), memory_s=float(rng.choice([0.0, 0.0, 2e-3])),
        step=float(rng.choice([0.0, 0.01])), jitter=float(rng.choice([0.0, 0.1, 0.3])),
        lost=float(rng.choice([0.0, 0.0, 0.01])), velocity_rad_s=float(rng.choice([0.0, 1e-3])),
        pace=float(rng.choice([0.6, 1.0, 1.4])),
    )  # fmt: skip
    u = rng.uniform(size=4)
    speed = float(np.exp(rng.uniform(np.log(0.03), np.log(0.25))))
    angle, order = str(rng.choice(["in", "out", "between"])), float(rng.choice([2.0, 3.0, 4.0, 6.0, 8.0]))
    wave = (angle, 15.0 * order if angle == "out" else order)
    hidden: list[tuple[str, dict[str, object], tuple[str, ...]]] = [
        ("nothing", {}, ()),
        ("constant torque", {"offset_Nm": level * (0.15 + 0.2 * u[0])}, ("constant_torque",)),
        ("asymmetry", {"asymmetry_Nm": level * (0.2 + 0.2 * u[0])}, ("constant_torque", "asymmetric_friction")),
        ("ripple", {"waves": ((*wave, level * (0.08 + 0.1 * u[0]), 6 * u[1]),)}, ("wave_generator_ripple",)),
        ("root of speed", {"root_Nm": level * (0.4 + 0.5 * u[0]), "coulomb_Nm": 0.6 * level}, ("sublinear_friction",)),
        ("Stribeck", {"stribeck_Nm": level * (0.3 + 0.5 * u[0]), "stribeck_rad_s": speed}, ("stribeck_friction",)),
        ("temperature", {"warmth_Nms_per_K": -arm.viscous_Nms * (0.01 + 0.015 * u[0])}, ("temperature_friction",)),
        ("presliding", {"bristle_rad": (2e-3 + 1e-2 * u[0],)}, ("hysteresis", "maxwell_slip_hysteresis")),
        ("presliding of three", {"bristle_rad": (1e-3, 5e-3, 2e-2 + 0.03 * u[0])},
         ("hysteresis", "maxwell_slip_hysteresis")),
        ("load friction", {"mesh": 0.05 + 0.05 * u[0], "weight_Nm": 25.0 + 30.0 * u[1]}, ("load_dependent_friction",)),
        ("actuator M3", {"weight_Nm": 25.0 + 30.0 * u[0], "actuator": {"motor": 0.04 + 0.1 * u[1],
         "load": 0.04 + 0.1 * u[1]}}, OF_BOTH_SIDES),
        ("actuator M6", {"weight_Nm": 25.0 + 30.0 * u[0], "stribeck_rad_s": 2.0,
         "actuator": M6_50 if u[1] < 0.5 else M6_100},
         OF_CREEP),
    ]  # fmt: skip
    case, sizes, right = hidden[i % len(hidden)]
    return sensing, replace(arm, **sizes), right, case  # type: ignore[arg-type]


EXACT = {
    "nothing": (),
    "constant torque": ("constant_torque",),
    "load friction of 7 %": ("load_dependent_friction",),
    "ripple of 3 % on the input": ("wave_generator_ripple",),
    "root of speed": ("sublinear_friction",),
    "Stribeck": ("stribeck_friction",),
    "temperature": ("temperature_friction",),
    "load friction without the rotor": ("load_dependent_friction",),
    "bristles of LuGre": ("lugre_friction",),
    "ripple that grows with speed": ("speed_ripple",),
    "kinematic error": ("kinematic_error",),
}
"""What makes the model exact, of the cases whose law stands in the catalogue as it is simulated."""


def model(*more: str) -> Model:
    """The model to begin with, and some effects."""
    finer = {"stribeck_friction", "lugre_friction"}.intersection(more)
    known = [name for name in KNOWN if not (name == "coulomb_friction" and finer)]
    return Model("drive", RATIO, math.nan, tuple(ModelEffect(name) for name in (*known, *more)))


def judged(case: str, seed: int) -> tuple[bool, bool, str]:
    """Whether the answer is right, whether it is wrong and bold, and the answer in a line."""
    if case.isdigit():
        sensing, arm, right, _ = drawn(int(case))
    else:
        sensing, arm, right = VARIED[case] if case in VARIED else (PLAIN_SENSING, *CASES[case])
    recording = record(arm, seed, sensing=sensing)
    began = time.process_time()
    found = diagnose([recording], model())
    ratio = found.error.nrmse / found.error.noise_floor_nrmse
    first = found.candidates[0] if found.candidates else None
    name = first.effect if first else ""
    good = found.verdict == "adequate" if not right else any(part in right for part in name.split("+"))
    bold = not good and (first is None or first.probability > BOLD) and found.verdict != "unexplained"
    told = ", ".join(f"{row.effect} {row.nrmse_after / row.nrmse_before:.2f} {row.probability:.2f}"
                     for row in found.candidates[:3])  # fmt: skip
    return good, bold, f"{found.verdict} at {ratio:.2f} floors; {told}; {time.process_time() - began:.1f} s"


def rows() -> list[Row]:
    """Shares right and bold, and what the exact model leaves."""
    answers = [judged(case, seed) for case in CASES for seed in (1, 2)]
    varied = [judged(case, 1) for case in VARIED]
    fresh = [judged(str(i), 100 + i) for i in range(DRAWN)]
    floors = []
    for case, more in EXACT.items():
        fitted = fit([record(CASES[case][0], 1)], model(*more))
        floors.append(fitted.solution.rmse / fitted.floor)
    return [
        Row("one encoder, right", sum(good for good, _, _ in answers) / len(answers), "1", 0.95, at_least=True),
        Row("one encoder, wrong and bold", sum(bold for _, bold, _ in answers), "1", 0.0),
        Row(
            "one encoder, other sensors, right",
            sum(good for good, _, _ in varied) / len(varied),
            "1",
            0.95,
            at_least=True,
        ),
        Row("one encoder, other sensors, wrong and bold", sum(bold for _, bold, _ in varied), "1", 0.0),
        Row("one encoder, drawn joints, right", sum(good for good, _, _ in fresh) / DRAWN, "1", 0.95, at_least=True),
        Row("one encoder, drawn joints, wrong and bold", sum(bold for _, bold, _ in fresh), "1", 0.0),
        Row("one encoder, exact model, worst", max(floors), "noise floors", ADEQUATE_FLOORS),
    ]


if __name__ == "__main__":
    for case in sys.argv[1:] or (*CASES, *VARIED, *map(str, range(DRAWN))):
        for seed in (100 + int(case),) if case.isdigit() else (1,) if case in VARIED else (1, 2):
            good, bold, told = judged(case, seed)
            name = f"{case}: {drawn(int(case))[3]}" if case.isdigit() else case
            print("ok   " if good else "BOLD " if bold else "wrong", name, seed, told, flush=True)
