"""How often faults are named rightly, by severity and by what is measured; faults that the table lacks included.

`bench_faults.py [GEARS]` draws so many gears of each fault and severity; all of it takes some minutes.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np
from bench_row import HEAD, Row, cells
from simulated_faults import BALL_MM, BALLS, PITCH_MM, RATIO, SICK, SIZES, heard, months
from simulated_year import year

from edge_daemon.faults.conditions import LINES
from edge_daemon.faults.orders import Bearing, line_levels, orders_of
from edge_daemon.faults.posterior import NONE, Drifts, posterior
from edge_daemon.health.judge import HealthJudge
from edge_daemon.health.trends import ConditionWatch
from edge_daemon.records import NE107, Estimate, Status
from edge_daemon.usage.gears import find_gear

GEARS, YEARS, SEED = 3, 10, 2026
GEAR = find_gear("CSG-20-100")
SETS = {
    "all and recordings": ("",),
    "all": ("order_",),
    "no sound": ("order_", "noise_"),
    "one encoder": ("order_", "stiffness", "damping", "kinematic_error", "hysteresis_area"),
    "sound alone": ("order_", "stiffness", "damping", "kinematic", "hysteresis", "coulomb", "ratio", "temperature"),
}
"""What is measured, by what is left out."""


def watch(rows: dict[str, np.ndarray]) -> ConditionWatch:
    """What the live watch knows after these hours."""
    seen = ConditionWatch("axis", GEAR)
    names, table = list(rows), np.array(list(rows.values())).T.tolist()
    for row in table:
        told = zip(names, row, strict=True)
        seen.update(1.0, {n: Estimate(n, v, 0.01, "", Status.VALID, 0.0) for n, v in told})
    return seen


def lines(rng: np.random.Generator, fault: str, size: float) -> dict[str, tuple[float, float]]:
    """Drifts of the lines between a recording of the gear when it was well, and one now."""
    orders = orders_of(Bearing(BALLS, BALL_MM / PITCH_MM), RATIO)
    well, ill = (line_levels(*heard(rng, *state), orders) for state in (("", 0.0), (fault, size)))
    by = {row.name: row.matters for row in LINES}
    return {n: ((ill[n][0] - well[n][0]) / by[n], math.hypot(ill[n][1], well[n][1]) / by[n]) for n in well}


def subset(drifts: Drifts, left_out: Sequence[str]) -> dict[str, tuple[float, float]]:
    return {name: told for name, told in drifts.items() if not any(part and name.startswith(part) for part in left_out)}


def verdicts(gears: int) -> dict[tuple[str, str, str], list[tuple[str, bool]]]:
    """(fault, severity, sensors) -> for each gear what was named, and whether the kinds left open held the truth."""
    found: dict[tuple[str, str, str], list[tuple[str, bool]]] = {}
    for place, (fault, (kind, _)) in enumerate(SICK.items()):
        for severity, size in SIZES.items():
            for gear in range(gears):
                rng = np.random.default_rng((SEED, place, gear, round(10 * size)))
                drifts = watch(months(rng, fault, size)).scaled() | lines(rng, fault, size)
                for sensors, left_out in SETS.items():
                    told = posterior(subset(drifts, left_out))
                    found.setdefault((fault, severity, sensors), []).append((told.named, kind in told.possible))
    return found


def confusion(gears: int = GEARS) -> list[Row]:
    found = verdicts(gears)
    rows = []
    for sensors in SETS:
        cases = [
            (SICK[f][0], f, s, named, held)
            for (f, s, one), all_ in found.items()
            if one == sensors
            for named, held in all_
        ]
        known = [case for case in cases if case[0] != "unknown"]
        right = [case for case in known if case[3] == case[0]]
        wrong = [case for case in cases if case[3] not in ("", NONE, "unknown", case[0])]
        by_size = ", ".join(
            f"{size} {sum(c[2] == size for c in right) / max(sum(c[2] == size for c in known), 1):.2f}"
            for size in SIZES
        )
        mixed = sorted({f"{c[1]} as {c[3]}" for c in wrong})
        rows.append(Row(f"{sensors}: named rightly, {len(known)} gears", len(right) / len(known), "1", peer=by_size))
        rows.append(Row(f"{sensors}: named wrongly", len(wrong) / len(cases), "1", 0.05, peer="; ".join(mixed)))
        held = float(np.mean([case[4] for case in cases]))
        rows.append(Row(f"{sensors}: kinds left open hold the true one", held, "1", 0.85, True))
    for fault, (kind, _) in SICK.items():
        each = {}
        for severity in SIZES:
            named = [name or "open" for name, _ in found[(fault, severity, "all and recordings")]]
            each[severity] = "/".join(sorted(set(named)))
        grave = [name == kind for name, _ in found[(fault, "grave", "all and recordings")]]
        told = "; ".join(f"{severity}: {name}" for severity, name in each.items())
        rows.append(Row(f"{fault} ({kind}), grave, named", float(np.mean(grave)), "1", peer=told))
    return rows


def false_alarms(years: int = YEARS) -> list[Row]:
    """Alarms of healthy gears over whole years, seasons included."""
    rng = np.random.default_rng(SEED)
    alarms = 0
    for _ in range(years):
        rows = year(rng)
        rows.pop("ratcheting_events")
        seen, judge = ConditionWatch("axis", GEAR), HealthJudge("axis", GEAR)
        names, table = list(rows), np.array(list(rows.values())).T.tolist()
        for hour, row in enumerate(table):
            told = zip(names, row, strict=True)
            seen.update(1.0, {n: Estimate(n, v, 0.01, "", Status.VALID, 0.0) for n, v in told})
            if hour % 24 == 0:
                events = judge.judge(hour * 3600.0, {}, findings=seen.findings()).events
                alarms += sum(event.severity is not NE107.OK for event in events)
                judge.acknowledge(hour * 3600.0)
    return [Row(f"false alarms per drive-year, {years} healthy years", alarms / years, "1/a", 0.35)]


def rows() -> list[Row]:
    """Everything."""
    return [*confusion(), *false_alarms()]


if __name__ == "__main__":
    print(" | ".join(HEAD))
    for line in [*confusion(int(sys.argv[1]) if sys.argv[1:] else GEARS), *false_alarms()]:
        print(" | ".join(cells(line)), flush=True)
