"""From the guarded motion to the stiffness, on the rig's own gear: three methods, one answer."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.estimate.methods import StiffnessMeasurement, compare_methods, measure
from edge_daemon.excite.profiles import course
from edge_daemon.rig.cia402_face import Motor
from edge_daemon.rig.motion import Course
from edge_daemon.rig.plant import SUBSTEP_S, Influence, Joint, Plant
from edge_daemon.settings import Profile
from tests.excite.drive_bench import Bench, excite, limits

JOINT = Joint(inertia_kg_m2=0.3, stiffness_Nm_per_rad=2.0e4, damping_Nms_per_rad=15.0, ratio=100.0)
LIMITS = {"travel_rad": 40.0, "acceleration_rad_s2": 9000.0, "torque_Nm": 2.0, "following_error_rad": 1.0}
SHAKE = Profile(
    name="shake", kind="multi_tone", speed_rad_s=85.0, seconds=9.0, frequency_hz=(1.3, 3.7, 7.9, 12.7), fade_s=0.5
)


def encoder(angle: list[float] | np.ndarray, bits: int, rng: np.random.Generator) -> np.ndarray:
    step = 2 * math.pi / 2**bits
    return np.round(np.asarray(angle) / step + rng.normal(0, 0.3, len(angle))) * step


def moved(rng: np.random.Generator) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
    """The profile through canopen, the drive and the gear, as two encoders saw it, and its phase marks."""
    bench = Bench(excite(limits(**LIMITS)))
    bench.face.motor = Motor(plant=Plant(JOINT))
    rows: list[tuple[float, float, float]] = []
    motor = bench.face.motor
    bench.each_ms = lambda b: rows.append((b.wall_s, motor.position_rad, motor.theta_out_rad))
    outcome = bench.runner().run(course(SHAKE, bench.settings.cycle_s))
    assert outcome.completed, outcome.reason
    time_s, inner, outer = np.array(rows).T
    columns = {"theta_in_rad": encoder(inner, 20, rng), "theta_out_rad": encoder(outer, 22, rng)}
    stamps = np.concatenate([row.time_s for row in bench.marks])
    phases = np.concatenate([row.value for row in bench.marks])
    return time_s, columns, phases[np.clip(np.searchsorted(stamps, time_s) - 1, 0, None)]


def held(rng: np.random.Generator) -> StiffnessMeasurement:
    """The motor stands while the output is loaded in steps of two seconds."""
    levels = np.array([0, 6, 12, 18, 12, 6, 0, -6, -12, -18, -12, -6, 0], dtype=float)

    def load(time_s: np.ndarray, _theta_in: np.ndarray) -> np.ndarray:
        return -levels[np.minimum((time_s / 2).astype(int), len(levels) - 1)]

    plant = Plant(JOINT, (Influence(torque=load),))
    steps = round(2 * len(levels) / SUBSTEP_S)
    middle = (np.arange(steps) + 0.5) * SUBSTEP_S
    still = Course(np.full(steps, 7.0), np.zeros(steps), np.zeros(steps))
    twist, _ = plant.run(middle, still, np.full(steps, 25.0))
    time_s, seen = middle[7::8] + SUBSTEP_S / 2, twist[7::8]
    sensor = -load(time_s, seen) + rng.normal(0, 0.02, len(time_s))
    columns = {
        "theta_in_rad": encoder(np.full(len(seen), 7.0), 20, rng),
        "theta_out_rad": encoder(0.07 - seen, 22, rng),
        "torque_out_Nm": sensor,
    }
    return measure("static", time_s, columns, JOINT.ratio, JOINT.inertia_kg_m2)


def test_three_methods_one_stiffness() -> None:
    rng = np.random.default_rng(17)
    time_s, columns, phase = moved(rng)
    steady = phase == 2
    assert np.ptp(time_s[steady]) > 8.9  # the marks say which part to measure on
    at = {name: column[steady] for name, column in columns.items()}
    rows = [
        held(rng),
        *(
            measure(method, time_s[steady], at, JOINT.ratio, JOINT.inertia_kg_m2)
            for method in ("frequency-response", "dynamic")
        ),
    ]
    for row in rows:
        assert abs(row.stiffness_Nm_per_rad - 2.0e4) < 4 * row.sd_Nm_per_rad < 0.01 * 2.0e4, row
    compared = compare_methods(rows)
    assert compared.agree, compared
