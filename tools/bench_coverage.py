"""Do live numbers keep what their standard deviations promise? Simulated drives, each with one effect of the catalogue.

.venv/bin/python tools/bench_coverage.py [DRIVES] [--effect NAME ...] [--way fitted|added] [--every]

Half of the drives are followed with a model that was fitted to a recording of them, half get their effect in mid-run,
as `add` leaves it. Every number that is called valid is held against what the simulated drive knows, soon after the
start or the addition and again later; blocks go straight through the estimator, without a daemon.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

import numpy as np  # noqa: E402
from bench_effects import TRUTHS  # noqa: E402
from bench_row import HEAD, Row, cells  # noqa: E402

from edge_daemon.config.settings import ChannelSettings, Drive, Estimation  # noqa: E402
from edge_daemon.effects.catalogue import find, of_balance  # noqa: E402
from edge_daemon.effects.model import Model, ModelEffect  # noqa: E402
from edge_daemon.errors import BadInput  # noqa: E402
from edge_daemon.identify.fit import fit  # noqa: E402
from edge_daemon.records import Array, Block, Status  # noqa: E402
from edge_daemon.rig.live import DEMO_EFFECTS, live_drive  # noqa: E402
from edge_daemon.rig.plant import Joint  # noqa: E402
from edge_daemon.text import table  # noqa: E402
from edge_daemon.track.live import DriveEstimator  # noqa: E402

DRIVES = 40
"""So many take some six minutes; the whole table is made of 200."""
WAYS = ("fitted", "added")
RATE_HZ, BLOCK = 1000.0, 100
BITS_IN = 17
BITS_OUT = (20, 22, 24)
"""Output encoders drawn from."""
FITTED_S = 15.0
"""of a recording that a model is fitted to"""
BEFORE_S = 20.0
"""of estimation before an effect is added"""
LOOKS_S = (10.0, 15.0, 20.0, 30.0)
"""Numbers are held against the truth so long after the start or the addition."""
Z_95 = 1.96
FAR = 5.0
"""No number that is called valid may be so many of its sd from the truth."""
LEAST, MOST = 0.90, 0.98
"""So much of the numbers 95 % intervals must hold, and no more, or they are too wide."""
EFFECTS = tuple(TRUTHS)
CATALOGUED = {row.name for row in of_balance("torsion")}
BASE = ("linear_stiffness", "viscous_damping", "kinematic_error")
FIXED = {f"kinematic_error.{name}": value for name, value in DEMO_EFFECTS["kinematic_error"].items()}


@dataclass(frozen=True, slots=True)
class Seen:
    """One number that was called valid."""

    drive: int
    effect: str
    way: str
    quantity: str
    after_s: float
    value: float
    sd: float
    truth: float

    @property
    def off(self) -> float:
        """Distance from the truth [sd]."""
        return (self.value - self.truth) / self.sd


@dataclass(frozen=True, slots=True)
class Recorded:
    """Stands for a recording."""

    time_s: Array
    columns: Mapping[str, Array]

    def part(self, begin_s: float, end_s: float) -> Recorded:
        """Of it."""
        at = slice(round(begin_s * RATE_HZ), round(end_s * RATE_HZ))
        return Recorded(self.time_s[at], {name: column[at] for name, column in self.columns.items()})


@dataclass(frozen=True, slots=True)
class Made:
    """A drive that ran for a while, and what is true about it."""

    recorded: Recorded
    joint: Joint
    bits_out: int
    truth: Mapping[tuple[str, str], float]
    """by effect and parameter"""


def made(number: int, effect: str) -> Made:
    """A drive drawn from its number, with an effect beside the kinematic error."""
    rng = np.random.default_rng([number, 0xC0FE])
    joint = Joint(
        inertia_kg_m2=rng.uniform(0.05, 0.2),
        stiffness_Nm_per_rad=rng.uniform(2e4, 1e5),
        damping_Nms_per_rad=rng.uniform(6.0, 15.0),
        ratio=100.0,
    )
    bits = int(rng.choice(BITS_OUT))
    effects = dict.fromkeys((effect, "kinematic_error"))
    drive = live_drive(number, [*effects], joint, BITS_IN, bits, parameters=FIXED)
    samples = drive.advance(max(FITTED_S, BEFORE_S) + LOOKS_S[-1] + 0.5)
    columns = {
        "theta_in_rad": samples.counts_in * (2 * math.pi / 2**BITS_IN),
        "theta_out_rad": samples.counts_out * (2 * math.pi / 2**bits),
        "temperature_degC": np.full(len(samples), drive.housing.temperature_degC),
    }
    return Made(Recorded(samples.time_s, columns), joint, bits, _truth(drive.truth["parameters"], joint, effect))


def _truth(drawn: object, joint: Joint, effect: str) -> Mapping[tuple[str, str], float]:
    assert isinstance(drawn, dict)
    own = {name.partition(".")[2]: value for name, value in drawn.items() if name.startswith(f"{effect}.")}
    known = TRUTHS[effect](own | {"stiffness": joint.stiffness_Nm_per_rad}) if effect != "kinematic_error" else {}
    return {(effect, name): value for name, value in known.items()} | {
        ("linear_stiffness", "stiffness"): joint.stiffness_Nm_per_rad,
        ("viscous_damping", "damping"): joint.damping_Nms_per_rad,
        ("kinematic_error", "kinematic_error"): 2 * FIXED["kinematic_error.order2_rad"],
        ("ratio", "ratio"): joint.ratio,
    }


def _drive(bits_out: int) -> Drive:
    steps = {"theta_in_rad": 2**BITS_IN, "theta_out_rad": 2**bits_out, "temperature_degC": None}
    rows = (ChannelSettings(channel=n, source="can", signal=n, counts_per_turn=steps[n]) for n in steps)
    return Drive(name="axis", modbus_device_id=1, model="axis.toml", channels=tuple(rows), estimation=Estimation())


def _blocks(recorded: Recorded) -> Iterator[Block]:
    for i in range(len(recorded.time_s) // BLOCK):
        part = {name: column[i * BLOCK : (i + 1) * BLOCK].copy() for name, column in recorded.columns.items()}
        flaws = {name: np.zeros(BLOCK, dtype=np.uint8) for name in part}
        yield Block("axis", i, 1000.0 + float(recorded.time_s[i * BLOCK]), RATE_HZ, part, flaws)


def model_of(drive: Made, effects: Sequence[str]) -> Model:
    """Nothing fitted."""
    rows = tuple(map(ModelEffect, dict.fromkeys((*BASE, *effects))))
    return Model("torsion", drive.joint.ratio, drive.joint.inertia_kg_m2, rows)


def followed(number: int, effect: str, way: str) -> Iterator[Seen]:
    """The numbers that were called valid of one drive."""
    drive = made(number, effect)
    begin_s = FITTED_S if way == "fitted" else BEFORE_S
    fitted = fit([drive.recorded.part(begin_s - FITTED_S, begin_s)], model_of(drive, (effect,))).model
    estimator = DriveEstimator(_drive(drive.bits_out), fitted if way == "fitted" else model_of(drive, ()))
    if way == "added":
        for block in _blocks(drive.recorded.part(0.0, begin_s)):
            estimator.update(block)
        estimator.replace_model(fitted)
    looks = {round(after_s * RATE_HZ / BLOCK): after_s for after_s in LOOKS_S}
    for i, block in enumerate(_blocks(drive.recorded.part(begin_s, begin_s + LOOKS_S[-1])), start=1):
        estimator.update(block)
        if i in looks:
            for name, value, sd, truth in _valid(estimator, drive):
                yield Seen(number, effect, way, name, looks[i], value, sd, truth)


def _valid(estimator: DriveEstimator, drive: Made) -> Iterator[tuple[str, float, float, float]]:
    """What is published, and the amplitudes behind it: (name, value, sd, truth)."""
    published = {row.name: row for row in estimator.estimates}
    for (effect, name), truth in drive.truth.items():
        shapes = {row.name: row.quantity for row in find(effect, "torsion").shapes} if effect in CATALOGUED else {}
        row = published.get(shapes.get(name, name))
        if row is None and name not in shapes:
            row = estimator.tracker.estimate(f"{effect} {name}", "", (effect, name))
        if row is not None and row.status is Status.VALID:
            yield row.name, row.value, row.sd, truth


def every(drives: int, effects: Sequence[str] = (), ways: Sequence[str] = WAYS) -> Iterator[list[Seen]]:
    """Effect by effect and way by way, in turn."""
    cases = [(effect, way) for effect in effects or EFFECTS for way in ways]
    for number in range(drives):
        effect, way = cases[number % len(cases)]
        try:
            yield list(followed(number, effect, way))
        except BadInput as problem:
            print(f"drive {number}, {effect}: {problem}", file=sys.stderr)


def _coverage(name: str, seen: Sequence[Seen]) -> Row:
    """Of one quantity; a drive counts once, for what it says at one instant it says at the next."""
    inside = float(np.mean([abs(row.off) < Z_95 for row in seen]))
    drives = len({row.drive for row in seen})
    doubt = math.sqrt(0.95 * 0.05 / drives)
    worst = max(seen, key=lambda row: abs(row.off))
    said = f"+-{100 * doubt:.0f} % of {drives} drives; worst {worst.off:+.1f} sd, {worst.effect} {worst.way}"
    return Row(f"{name}: 95 % intervals cover", 100 * inside, "%", 100 * LEAST - 200 * doubt, True, said)


def summary(found: Sequence[Seen]) -> list[Row]:
    """Coverage by quantity, soon after an addition, and what is far off."""
    names = sorted({row.quantity for row in found})
    soon = [row for row in found if row.way == "added" and row.after_s == LOOKS_S[0]]
    far = [row for row in found if not abs(row.off) <= FAR]
    what = sorted({f"{row.effect} {row.quantity}" for row in far})
    all_of_it = float(np.mean([abs(row.off) < Z_95 for row in found]))
    return [
        *(_coverage(name, [row for row in found if row.quantity == name]) for name in names),
        *([_coverage(f"right after an addition ({LOOKS_S[0]:g} s)", soon)] if soon else []),
        Row("all numbers: 95 % intervals cover at most", 100 * all_of_it, "%", 100 * MOST),
        Row(f"valid and more than {FAR:g} sd off", len(far), f"of {len(found)}", 0, peer=", ".join(what)),
    ]


def rows(drives: int = DRIVES) -> list[Row]:
    """The table; limits of coverage carry two standard deviations of their own chance."""
    return summary([seen for row in every(drives) for seen in row])


def main() -> None:
    """Prints the table, and what was far off."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drives", type=int, nargs="?", default=DRIVES)
    parser.add_argument("--effect", nargs="+", default=[])
    parser.add_argument("--way", nargs="+", default=WAYS, choices=WAYS)
    parser.add_argument("--every", action="store_true", help="print every number")
    given = parser.parse_args()
    found = []
    for one in every(given.drives, given.effect, given.way):
        found += one
        for row in one if given.every else (row for row in one if not abs(row.off) <= FAR):
            said = f"{row.value:.6g} +- {row.sd:.2g}, truth {row.truth:.6g}, {row.off:+.1f} sd"
            print(f"{row.drive} {row.effect} {row.way} {row.after_s:g} s {row.quantity} {said}", flush=True)
    print(table(HEAD, map(cells, summary(found))))


if __name__ == "__main__":
    main()
