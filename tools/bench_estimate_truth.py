"""Estimation against the truth: efficiency, leaks, drift, and the first article's simulation.

.venv/bin/python tools/bench_estimate_truth.py [RUNS]      Monte-Carlo runs, 200 unless told
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

import compiled_joint  # noqa: E402
import cramer_rao  # noqa: E402
from bench_row import HEAD, Row, cells  # noqa: E402

from edge_daemon.condition.gathering import GATHERED_S  # noqa: E402
from edge_daemon.effects.model import Model, ModelEffect  # noqa: E402
from edge_daemon.identify.fit import fit  # noqa: E402
from edge_daemon.motion.kinematics import motion_of, uniform  # noqa: E402
from edge_daemon.motion.noise_level import compress  # noqa: E402
from edge_daemon.sound.noise_model import fit_noise  # noqa: E402
from edge_daemon.sound.noise_steps import terms  # noqa: E402
from edge_daemon.sound.spectrum import Spectrum  # noqa: E402
from edge_daemon.text import table  # noqa: E402
from edge_daemon.track.live import DriveEstimator  # noqa: E402
from edge_daemon.track.recursive import AmplitudeFilter  # noqa: E402
from tests.motion import simulated_joint as rig  # noqa: E402

RUNS = 200
PATHS = 50
"""motions that the runs share: rounding errors of one motion are no white noise, only those of many are"""
SECONDS = 30.0
GATHERED = round(GATHERED_S * rig.RATE_HZ)
"""samples of a block as the daemon's estimation takes them"""
COULOMB = ("linear_stiffness", "viscous_damping", "coulomb_friction")
STEADY = {"warm_up_s": 1.0, "stiffness_drift_per_h": 1e-9}
"""the bound is that of parameters that do not change: no drift is allowed for"""
TONES = ((5.37, 0.4), (9.13, 0.4), (13.77, 0.4), (19.33, 0.4))
SWEEP = (0.23, 1.2)
"""repeats after SECONDS only: a rounding error that comes back with the motion would not average out"""
REPORTED = {"coulomb": "coulomb_friction"}
BATCH = {
    "stiffness": ("linear_stiffness", "stiffness"),
    "damping": ("viscous_damping", "damping"),
    "coulomb": ("coulomb_friction", "friction"),
    "reversal": ("coulomb_friction", "smoothing"),
}
TRUE_HZ = 40_000.0
"""steps of the truth with friction: at 10 kHz they err by as much as a tenth of a 24-bit step"""
OWN_HZ = 30.0
"""below which the motor's own motion lies, with a margin of half: the batch fit tells it from the recording, the live
estimates know of no more than the balance's cut-off; the bound of either knows as much"""
TURN = np.linspace(0.0, 2 * math.pi, 20_001)
"""motor angles at which a peak-to-peak value is read: 2001 lose a quarter of the bound at 24 bits"""
LOSS_RUNS, LOSS_MOTIONS = 20, 2


def last_estimates(joint: rig.Joint, angles: tuple[np.ndarray, np.ndarray], names: tuple[str, ...], **settings: float):
    """The live estimates at the end of a recording, by name."""
    estimator = DriveEstimator(rig.drive_settings(joint, **settings), rig.model_of(joint, *names))
    rows = ()
    for block in rig.blocks(joint, *angles, size=GATHERED):
        rows = estimator.update(block)
    return {row.name: row for row in rows}


def scores(joint: rig.Joint, names: tuple[str, ...], dry: bool, paths: int, runs: int):
    """Twice parameter -> (runs, 2), live and batch: error over the Cramer-Rao bound, and over the sd stated.

    Each run has its own encoder zeros and so its own rounding errors; runs share a few motions. The bound counts the
    rounding of both encoders as white noise, takes the torque model as known in form, and K, B, F_c, the kinematic
    error's orders, the encoders' zero and R as unknown together. The width of the friction's sign is given to the live
    estimates, and fitted in batch, and so is the band in which the motor moves: the bound of either says so too.
    """
    live: dict[str, list[tuple[float, float]]] = {}
    batch: dict[str, list[tuple[float, float]]] = {}
    simulate = compiled_joint.stepped if dry else rig.linear
    for seed in range(paths):
        path = rig.Path(TONES, SWEEP, seed, SECONDS)
        given = cramer_rao.bounds(joint, path, simulate)
        freed = cramer_rao.bounds(joint, path, simulate, width=True, motor_hz=OWN_HZ)
        angles = compiled_joint.stepped(joint, path, TRUE_HZ) if dry else rig.linear(joint, path)
        rng = np.random.default_rng(seed)
        for _ in range(math.ceil(runs / paths)):
            zeros = rng.uniform(0.0, 1.0, 2)
            last = last_estimates(joint, (angles[0] + zeros[0], angles[1] + zeros[1]), names, **STEADY)
            found = {name: last[REPORTED.get(name, name)] for name in given}
            _score(live, joint, given, {name: (row.value, row.sd) for name, row in found.items()})
            _score(batch, joint, freed, batch_estimates(joint, angles, names, rng.uniform()))
    return tuple({name: np.array(column) for name, column in found.items()} for found in (live, batch))


def _score(into: dict, joint: rig.Joint, bound: dict[str, float], found: dict[str, tuple[float, float]]) -> None:
    """Add the errors over the bound, and over the sd stated."""
    for name, (value, sd) in found.items():
        error = value - truth(joint, name)
        into.setdefault(name, []).append((error / bound[name], error / sd))


@dataclass(frozen=True)
class Recorded:
    """Stands for a recording."""

    time_s: np.ndarray
    columns: dict[str, np.ndarray]


def batch_estimates(joint: rig.Joint, angles: tuple[np.ndarray, np.ndarray], names: tuple[str, ...], turned: float):
    """Value and sd of each parameter by the batch fit, both angles `turned` [rad of the output] further."""
    columns = {
        "theta_in_rad": rig.quantised(angles[0] + joint.ratio * turned, joint.in_bits),
        "theta_out_rad": rig.quantised(angles[1] + turned, joint.out_bits),
    }
    names = (*(names or ("linear_stiffness", "viscous_damping")), "kinematic_error")
    fitted = fit([Recorded(np.arange(len(angles[0])) / rig.RATE_HZ, columns)], rig.model_of(joint, *names))
    rows = {row.name: row.parameters for row in fitted.model.effects}
    found = {} if fitted.sharp is None else {"ratio": fitted.sharp.ratio}
    for name, (effect, parameter) in BATCH.items():
        if effect in rows:
            found[name] = (rows[effect][parameter].value, rows[effect][parameter].sd)
    waves = rows["kinematic_error"]
    shapes = {f"{word}_{m}": wave(m * TURN) for m in (1, 2, 4) for word, wave in (("sine", np.sin), ("cosine", np.cos))}
    course = sum(waves[key].value * shape for key, shape in shapes.items())
    top, bottom = int(np.argmax(course)), int(np.argmin(course))
    spread = math.sqrt(sum((waves[key].sd * (shape[top] - shape[bottom])) ** 2 for key, shape in shapes.items()))
    return found | {"kinematic_error": (float(np.ptp(course)), spread)}


def truth(joint: rig.Joint, name: str) -> float:
    """What the simulation was given."""
    return float(np.ptp(rig.kinematic(joint, TURN)) if name == "kinematic_error" else getattr(joint, name))


def efficiency(runs: int) -> list[Row]:
    """RMSE over the bound, bias and coverage of the live estimates, without and with friction in gear and model."""
    smooth = rig.Joint(out_bits=20)
    dry = rig.Joint(out_bits=24, coulomb=0.5)
    rows = []
    for label, joint, names in (
        ("20 bits", smooth, ()),
        ("dry, 24 bits", dry, COULOMB),
        ("dry, 20 bits", replace(dry, out_bits=20), COULOMB),
    ):
        live, batch = scores(joint, names, bool(names), min(PATHS, runs), runs)
        for name, column in live.items():
            rows += _efficiency_rows(f"{label}, {name}", column, 1.15)
        for name, column in batch.items():
            rows += _efficiency_rows(f"batch, {label}{', width fitted' * bool(names)}, {name}", column, 1.05)
    return rows


def _efficiency_rows(name: str, column: np.ndarray, most: float) -> list[Row]:
    runs = len(column)
    chance = 2 / math.sqrt(runs)
    spread, z = float(np.sqrt(np.mean(column[:, 0] ** 2))), column[:, 1]
    inside = 100 * float(np.mean(np.abs(z) < 1.96))
    off = 2.0 + 200 * math.sqrt(0.05 * 0.95 / runs)
    return [
        Row(f"{name}: RMSE over Cramer-Rao", spread, "1", most * (1 + chance / 1.4), peer=f"{runs} runs"),
        Row(f"{name}: bias over sd", abs(float(z.mean())), "1", 0.2 + chance),
        Row(f"{name}: 95 % interval off its 95 %", abs(inside - 95.0), "%", off, peer=f"covers {inside:.1f} %"),
    ]


def hidden_kinematic_error() -> list[Row]:
    """How far a hidden error of 1 arc-min moves the stiffness: live, and for a fit that leaves the error out."""
    moved, left_out = [], []
    for seed in range(8):
        path = rig.Path(TONES, SWEEP, seed, SECONDS)
        plain, wavy = rig.Joint(out_bits=20, kinematic_pp=1e-12), rig.Joint(out_bits=20)
        with_, without = (last_estimates(j, rig.linear(j, path), ())["stiffness"] for j in (wavy, plain))
        moved.append(abs(with_.value - without.value) / math.hypot(with_.sd, without.sd))
        left_out.append(abs(_without_waves(wavy, path) / _without_waves(plain, path) - 1))
    median = float(np.median(left_out))
    return [
        Row(
            "stiffness moved by a hidden arc-min, worst of 8",
            max(moved),
            "sd",
            2.0,
            peer=f"error left out of the fit: {100 * median:.1f} % of K",
        )
    ]


def _without_waves(joint: rig.Joint, path: rig.Path) -> float:
    """Stiffness of a batch fit that knows nothing of kinematic error."""
    theta_in, theta_out = rig.linear(joint, path)
    columns = {"theta_in_rad": theta_in, "theta_out_rad": rig.quantised(theta_out, joint.out_bits)}
    time_s = np.arange(len(theta_in)) / rig.RATE_HZ
    motion, valid = motion_of(uniform(time_s, columns), joint.ratio, joint.inertia, 100.0)
    rows = np.column_stack((motion.twist_rad, motion.twist_rate_rad_s, np.ones(len(time_s))))[valid]
    return float(np.linalg.lstsq(rows, motion.torque_Nm[valid], rcond=None)[0][0])


def sudden_loss() -> list[Row]:
    """Delay until a loss of 1 % is noticed and told, over that of a CUSUM that knows all but the instant.

    That CUSUM sums the log likelihood ratio of the two true output angles; its delay is threshold over information
    rate (Lorden 1971), the threshold that of one false alarm an hour. So is the live one's (see `estimate.change`).
    """
    joint, at_s = rig.Joint(out_bits=20), 12.0
    found, optimal, early = [], [], 0
    for seed in range(LOSS_MOTIONS):
        path = rig.Path(TONES, SWEEP, 5 + seed, 18.0)
        after = rig.stepped(joint, path, lambda t: joint.stiffness * (1.0 if t < at_s else 0.99))
        apart = (after[1] - rig.stepped(joint, path)[1])[round((at_s + 0.5) * rig.RATE_HZ) :]
        per_s = float(np.mean(apart**2)) / (2 * cramer_rao.noise_rad(joint) ** 2) * rig.RATE_HZ
        optimal.append(math.log(3600.0 * per_s) / per_s)
        rng = np.random.default_rng(seed)
        for _ in range(LOSS_RUNS // LOSS_MOTIONS):
            told = _told_s(joint, tuple(angle + rng.uniform() for angle in after))
            early += sum(t <= at_s for t in told)
            found.append(next((t - at_s for t in told if t > at_s), math.inf))
    watched_min = LOSS_RUNS * (at_s - 4.0) / 60
    return [
        Row(
            "loss of 1 %: mean delay over the optimal CUSUM's",
            float(np.mean(found) / np.mean(optimal)),
            "1",
            1.5,
            peer=f"{np.mean(optimal):.2f} s; {LOSS_RUNS} runs, {early} false alarms in {watched_min:.1f} min",
        )
    ]


def _told_s(joint: rig.Joint, angles: tuple[np.ndarray, ...]) -> list[float]:
    """When sudden changes of stiffness were told, from the start of the data."""
    estimator = DriveEstimator(rig.drive_settings(joint, warm_up_s=2.0), rig.model_of(joint))
    told = []
    for i, block in enumerate(rig.blocks(joint, *angles, size=GATHERED)):
        estimator.update(block)
        if any("stiffness" in text for text in estimator.take_notices()):
            told.append((i + 1) * block.size / rig.RATE_HZ)
    return told


def slow_drift() -> list[Row]:
    """How late the filter follows a stiffness that falls by 0.1 % an hour, at the drift that the settings allow."""
    rng = np.random.default_rng(3)
    stiffness, twist_rad, noise_Nm, block_s = 1e5, 2.3e-5, 0.2, 0.1
    drift = stiffness * 1e-3 / math.sqrt(3600.0)
    filt = AmplitudeFilter(np.array([stiffness]), np.array([stiffness]), np.array([drift]))
    behind, hours = [], 2.0
    count = round(hours * 3600 / block_s)
    for i in range(count):
        now = stiffness * (1 - 1e-3 * i * block_s / 3600)
        columns = twist_rad * rng.normal(size=(20, 1))
        block = compress(columns, columns[:, 0] * now + noise_Nm * rng.normal(size=20))
        filt.update(block, noise_Nm, block_s)
        if i > count // 2:
            behind.append(float(filt.value[0]) - now)
    lag_s = float(np.mean(behind)) / (stiffness * 1e-3 / 3600)
    off = float(np.sqrt(np.mean(np.square(behind)))) / stiffness
    return [
        Row("lag behind a drift of 0.1 % an hour", lag_s, "s", 600.0, peer="limit chosen: a sixth of an hour"),
        Row("error under that drift, relative", off, "1", 1e-3, peer=f"stated sd {filt.sd[0] / stiffness:.1e}"),
    ]


def first_article(runs: int) -> list[Row]:
    """Its noise spectrum and its k0, k1, k2, under its conditions; and what real encoders leave of k1."""
    rng = np.random.default_rng(1)
    frequency = np.linspace(10.0, 10_000.0, 999)
    truth_ = np.array([1.0, 1.0, 1.0, 1.0, 1.0])
    psd = terms(frequency, 300.0) @ truth_
    worst, most = 0.0, 0
    for _ in range(min(runs, 50)):
        seen = fit_noise(Spectrum(frequency, psd * (1 + 1e-4 * rng.normal(size=len(psd))), 1e8))
        worst, most = max(worst, float(np.max(np.abs(seen.value - truth_)))), max(most, seen.iterations)
    return [
        Row("article 1: noise coefficients, worst error", 100 * worst, "%", 1.0, peer="Gaussian noise of 1e-4"),
        Row("article 1: iterations", most, "1", 10.0),
        *_polynomial_stiffness(),
    ]


def _polynomial_stiffness() -> list[Row]:
    """k0 phi + k1 phi^2 + k2 phi^3 from exact angles, then the bound on k1 at 23 bits and a minute of 20 Hz."""
    k = np.array([1e5, -1e3, 5.0])
    t = np.arange(60_000) / 1000.0
    phi = 2e-4 * np.sin(2 * math.pi * 20.0 * t)
    columns = np.column_stack((phi, phi**2, phi**3))
    scale = np.linalg.norm(columns, axis=0)
    exact = np.linalg.lstsq(columns / scale, columns @ k, rcond=None)[0] / scale
    error = np.abs(exact / k - 1) * 100
    noise_Nm = 1e5 * 2 * math.pi / 2**23 / math.sqrt(12)
    least = noise_Nm * np.sqrt(np.diag(np.linalg.inv((columns / scale).T @ (columns / scale)))) / scale
    share = np.abs(least / k)
    larger = [f"k{i}: {share[i] * 3:.0e} times the twist, or its square times the minutes" for i in (1,)]
    return [
        Row("article 1: k0 from exact angles, error", float(error[0]), "%", 5.0),
        Row("article 1: k1 from exact angles, error", float(error[1]), "%", 5.0),
        Row("article 1: k2 from exact angles, error", float(error[2]), "%", 5.0, peer="2e-12 of the torque"),
        *_polynomial_by_fit(k),
        Row("article 1: sd over k1 at 23 bits", float(share[1]), "1", peer=f"not identifiable; needs {larger[0]}"),
        Row("article 1: sd over k2 at 23 bits", float(share[2]), "1", peer="not identifiable"),
    ]


def _polynomial_by_fit(k: np.ndarray) -> list[Row]:
    """The same by the product's own fit, from exact angles and an exact torque sensor."""
    t = np.arange(20_000) / 1000.0
    phi = 2e-4 * np.sin(2 * math.pi * 20.0 * t)
    out = 1e-9 * np.sin(2 * math.pi * 0.2 * t)
    torque = k[0] * phi + k[1] * phi**2 + k[2] * phi**3
    columns = {"theta_in_rad": 100.0 * (phi + out), "theta_out_rad": out, "torque_out_Nm": torque}
    names = ("linear_stiffness", "polynomial_stiffness")
    model = Model("torsion", 100.0, math.nan, tuple(map(ModelEffect, names)))
    found = fit([Recorded(t, columns)], model).model
    k1, k2 = (found.effects[1].parameters[name] for name in ("k1", "k2"))
    beyond = "not identified" if not k2.identified else "identified"
    return [
        Row("article 1: k0 by `fit`, exact, error", 100 * abs(found.value(names[0], "stiffness") / k[0] - 1), "%", 5.0),
        Row("article 1: k1 by `fit`, exact, error", 100 * abs(k1.value / k[1] - 1), "%", 5.0),
        Row("article 1: k2 by `fit`, exact, error", 100 * abs(k2.value / k[2] - 1), "%", peer=f"called {beyond}"),
    ]


def rows(runs: int = RUNS) -> list[Row]:
    """All figures; the Monte-Carlo limits carry two standard deviations of their own chance."""
    return [*hidden_kinematic_error(), *sudden_loss(), *slow_drift(), *first_article(runs), *efficiency(runs)]


if __name__ == "__main__":
    print(table(HEAD, map(cells, rows(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS))))
