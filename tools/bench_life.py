"""How good the forecast, the alarms and the cycle counter are, against truth that does not know them.

The full run takes about twelve minutes on one idle core; EDGE_DAEMON_BENCH_GEARS=20 in the environment is a short one,
and every row says how many gears it is of. By itself it takes options: `bench_life.py [GEARS] [FAMILY]`, without a
family all of them, one after the other; `bench_life.py failures [GEARS [TAUGHT [FAMILY ...]]]` shows the families by
laws of their own alone.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import life_rivals
import numpy as np
import simulated_aside
import simulated_unseen
from bench_row import HEAD, Row, cells
from simulated_aside import ASIDE, run_aside
from simulated_failures import FAILURES, HELD_ASIDE, run_to_end
from simulated_fleets import run_of_fleet
from simulated_gears import FAMILIES, Array, Life, run_to_failure
from simulated_laws import LAWS, draw_constants, run_by_constants, run_by_law
from simulated_unseen import UNSEEN, run_unseen
from simulated_year import FAULTS, START_H, year

from edge_daemon.health.judge import HealthJudge
from edge_daemon.health.trends import ConditionWatch
from edge_daemon.prognose.forecast import MAKERS, Prior, foresee
from edge_daemon.prognose.learn import FailedGear, learn_law, learn_life
from edge_daemon.records import NE107, Estimate, Status
from edge_daemon.usage.cycles import CycleCounter
from edge_daemon.usage.evidence import evidence_of
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import rows_of

GEARS = int(os.environ.get("EDGE_DAEMON_BENCH_GEARS", "200"))
TAUGHT = 60
YEARS, FLEETS, SEED = 20, 20, 2024
FAMILY = "fleet"
CUTS = (0.3, 0.5, 0.7, 0.8, 0.9)
UNLIKE_CUTS = (0.3, 0.5, 0.7)
UNLIKE_GEARS, UNLIKE_TAUGHT = max(GEARS // 10, 2), 30
"""of each family, whose kind is taken out of the shipped prior first: gears whose like has never been seen"""
FAILED_GEARS, FAILED_TAUGHT, FAILED_CUTS = max(GEARS // 8, 2), (5, 15, 50), (0.5, 0.7)
"""of each family of `simulated_failures`"""
OWN_LAWS = (*FAILURES, *ASIDE, *UNSEEN)
LOOKED_AT = {*FAILURES, *simulated_aside.LOOKED_AT, *simulated_unseen.LOOKED_AT} - {HELD_ASIDE}
ALPHA = 0.2
FUTURES = 9
"""The median of so many ends of the same gear is what one forecasts who knows it exactly."""
GEAR = find_gear("CSG-20-100")
ALL = [*FAMILIES, *LAWS, "fleets"]

Way = Callable[[np.random.Generator, Array, dict[str, Array]], Array]


def product(prior: Prior) -> Way:
    """The product's forecast as remaining lives (n,)."""

    def run(rng: np.random.Generator, time_h: Array, columns: dict[str, Array]) -> Array:
        ledger = rows_of(GEAR, time_h, np.ones_like(time_h), columns)
        left: Array = foresee(GEAR, ledger, evidence_of(ledger), prior).remaining_h
        return left

    return run


def crps(samples: Array, truth: float) -> float:
    """Continuous ranked probability score of an ensemble (Gneiting and Raftery 2007, eq. 21)."""
    ordered, n = np.sort(samples), samples.size
    spread = float(np.sum((2 * np.arange(1, n + 1) - n - 1) * ordered)) / n**2
    return float(np.mean(np.abs(ordered - truth))) - spread


class Score:
    """Figures of one way over all gears and cuts."""

    def __init__(self, way: Way, lives: Sequence[Life], cuts: Sequence[float] = CUTS) -> None:
        rng = np.random.default_rng(SEED)
        self.cuts = tuple(cuts)
        self.inside, self.near, self.crps, self.close, self.rank = (np.zeros((len(lives), len(cuts))) for _ in range(5))
        for i, life in enumerate(lives):
            for j, cut in enumerate(cuts):
                time_h, columns = life.until(cut)
                left, truth = way(rng, time_h, columns), life.life_h - time_h[-1]
                p10, p50, p90 = np.quantile(left, (0.1, 0.5, 0.9))
                self.inside[i, j] = p10 <= truth <= p90
                self.near[i, j] = abs(p50 - truth) <= ALPHA * truth
                self.close[i, j] = abs(p50 - truth) <= ALPHA * life.life_h / 2
                self.crps[i, j] = crps(left, truth) / life.life_h
                self.rank[i, j] = np.mean(left < truth)

    @property
    def half(self) -> float:
        """Alpha-lambda accuracy at half life."""
        return float(self.near[:, self.cuts.index(0.5)].mean())

    @property
    def horizon(self) -> float:
        """Mean share of life before failure from which the median stays within 10 % of the life."""
        held = np.cumprod(self.close[:, ::-1], axis=1).sum(axis=1).astype(int)
        ahead = [0.0, *(1.0 - cut for cut in reversed(self.cuts))]
        return float(np.mean([ahead[n] for n in held]))

    def covered(self) -> str:
        """Coverage by share of life."""
        return " ".join(f"{cut:g}:{share:.2f}" for cut, share in zip(self.cuts, self.inside.mean(axis=0), strict=True))

    def in_short(self) -> str:
        """Within 20 % by share of life, coverage and CRPS."""
        near = " ".join(f"{cut:g}:{share:.2f}" for cut, share in zip(self.cuts, self.near.mean(axis=0), strict=True))
        return f"{near} cover {self.inside.mean():.2f} CRPS {self.crps.mean():.3f}"

    def told(self) -> str:
        by_cut = " ".join(f"{cut:g}:{score:.3f}" for cut, score in zip(self.cuts, self.crps.mean(axis=0), strict=True))
        told = f"alpha-lambda {self.half:.2f}, coverage {self.inside.mean():.2f}, horizon {self.horizon:.2f}"
        return f"{told}, CRPS {by_cut}"


def lived(rng: np.random.Generator, family: str) -> Life:
    """One life of a family of any simulation."""
    if family == "fleets":
        return run_of_fleet(rng)
    return run_by_law(rng, family) if family in LAWS else run_to_failure(rng, family)


def _taught(lives: Sequence[Life]) -> Prior:
    return learn_life(GEAR, [FailedGear(life.time_h, life.columns) for life in lives])


def unlike(gears: int = UNLIKE_GEARS) -> list[Row]:
    """Every family with the shipped prior less its own kind, beside a prior learned from thirty of its like.

    Where even the second misses, one kind of gear is too narrow for the family: its gears differ in law and limit.
    """
    rows, own, known = [], [], []
    for family in ALL:
        rng = np.random.default_rng(SEED)
        others = Prior(tuple(kind for kind in MAKERS.kinds if kind.name != family), MAKERS.doubt)
        taught = _taught([lived(rng, family) for _ in range(UNLIKE_TAUGHT)])
        lives = [lived(rng, family) for _ in range(gears)]
        own.append(Score(product(others), lives, UNLIKE_CUTS))
        known.append(Score(product(taught), lives, UNLIKE_CUTS))
        beside = f"taught by {UNLIKE_TAUGHT} of its like {known[-1].half:.2f}; untaught {own[-1].told()}"
        rows.append(Row(f"{family}: alpha-lambda, never seen, {gears} gears", own[-1].half, peer=beside))
    inside, best = (float(np.mean([score.inside for score in scores])) for scores in (own, known))
    half, reached = (float(np.mean([score.half for score in scores])) for scores in (own, known))
    count = f"{len(ALL)} families never seen"
    return [
        Row(f"{count}: coverage of 80 %", inside, "1", 0.75, True, f"taught {best:.2f}"),
        Row(f"{count}: the same, not above", inside, "1", 0.85),
        Row(f"{count}: alpha-lambda at half life", half, "1", 0.8, True, f"taught {reached:.2f}"),
        *rows,
    ]


def forecasts(gears: int = GEARS, family: str = FAMILY) -> list[Row]:
    """A prior taught by failed gears of the same family, and the rivals taught by the same."""
    rng = np.random.default_rng(SEED)
    taught = [lived(rng, family) for _ in range(TAUGHT)]
    lives = [lived(rng, family) for _ in range(gears)]
    prior, known = _taught(taught), life_rivals.learn(taught)
    rivals: dict[str, Way] = {"exponential degradation": lambda r, t, c: life_rivals.exponential(r, known, t, c)}
    filtered = life_rivals.progpy_filter()
    if filtered is not None:
        rivals["ProgPy particle filter"] = lambda r, t, c: filtered(r, known, t, c)
    own, fresh = Score(product(prior), lives), Score(product(MAKERS), lives, UNLIKE_CUTS)
    inside = float(own.inside.mean())
    name = f"{family}, taught by {TAUGHT}"
    rows = [
        Row(f"{name}: alpha-lambda accuracy at half life, {gears} gears", own.half, "1", 0.8, True, own.told()),
        Row(f"{name}: coverage of the 80 % interval", inside, "1", 0.75, True, own.covered()),
        Row(f"{name}: the same, not above", inside, "1", 0.85),
        Row(f"{family}: alpha-lambda with the shipped prior", fresh.half, "1", peer=fresh.told()),
    ]
    for rival, way in rivals.items():
        other = Score(way, lives)
        ratio = float(own.crps.mean() / other.crps.mean())
        rows.append(Row(f"{name}: CRPS over {rival}, {gears} gears", ratio, "1", 0.8, peer=other.told()))
        longer = own.horizon / max(other.horizon, 1e-9)
        rows.append(Row(f"{name}: horizon over {rival}, {gears} gears", longer, "1", 1.2, True))
    return rows


def reached(lives: Sequence[Life], cuts: Sequence[float] = FAILED_CUTS) -> str:
    """Share within 20 % by share of life of a forecast that knows law and gear, and not the future."""
    rng, told = np.random.default_rng(SEED), []
    for cut in cuts:
        near = []
        for life in lives:
            if life.again is not None:
                seen = max(int(cut * life.time_h.size), 1)
                left = float(np.median([life.again(rng, seen) for _ in range(FUTURES)])) - seen
                near.append(abs(left - (life.life_h - seen)) <= ALPHA * (life.life_h - seen))
        told.append(f"{cut:g}:{np.mean(near):.2f}" if near else f"{cut:g}:-")
    return " ".join(told)


def failures(
    gears: int = FAILED_GEARS, taught: Sequence[int] = FAILED_TAUGHT, families: Sequence[str] = OWN_LAWS
) -> list[Row]:
    """Families by laws of their own: taught by few gears, beside boosted trees, the law alone and the maker's prior."""
    rows = []
    for family in families:
        rng = np.random.default_rng(SEED)
        run = run_aside if family in ASIDE else run_unseen if family in UNSEEN else run_to_end
        lives = [run(rng, family) for _ in range(gears + max(taught))]
        tested, known = lives[:gears], lives[gears:]
        makers = Score(product(MAKERS), tested, FAILED_CUTS)
        many = life_rivals.bound([run(rng, family) for _ in range(life_rivals.MANY_GEARS)])
        shown = "" if many is None else Score(many, tested, FAILED_CUTS).in_short()
        limit = reached(tested)
        for count in taught:
            prior = learn_life(GEAR, [FailedGear(life.time_h, life.columns) for life in known[:count]], rounds=6)
            own = Score(product(prior), tested, FAILED_CUTS)
            beside = {"law": Score(product(replace(prior, experience=None)), tested, FAILED_CUTS), "makers": makers}
            boosted = life_rivals.boosting(known[:count])
            if boosted is not None:
                beside["boosting"] = Score(boosted, tested, FAILED_CUTS)
            best = min(float(score.crps.mean()) for score in beside.values())
            weights = prior.experience.weights if prior.experience else ()
            told = "; ".join(f"{name} {score.in_short()}" for name, score in beside.items())
            told += f"; taught by {life_rivals.MANY_GEARS} gears {shown}" if shown else ""
            told += f"; law and gear known, not the future {limit}"
            aside = "" if family in LOOKED_AT else ", held aside"
            name = f"{family}{aside}, taught by {count}, {gears} gears"
            half, late = own.near.mean(axis=0)
            rows += [
                Row(f"{name}: within 20 % at 70 %", float(late), "1", 0.8, True, f"own {own.in_short()}; {told}"),
                Row(f"{name}: within 20 % at half", float(half), "1", peer=f"weights {weights}"),
                Row(f"{name}: coverage of 80 %", float(own.inside.mean()), "1", 0.7, True, own.covered()),
                Row(f"{name}: CRPS over the best beside", float(own.crps.mean()) / best, "1", 1.0),
            ]
    return rows


def _alarms(rng: np.random.Generator, fault: str, size: float) -> tuple[int, float, bool]:
    """False alarms before the fault (or in the year), delay [h] of the first right after it, right pattern named."""
    truth = year(rng, fault, size)
    names, rows = list(truth), np.array(list(truth.values())).T
    watch, judge = ConditionWatch("axis", GEAR), HealthJudge("axis", GEAR)
    false, delay, right = 0, float("nan"), False
    for hour, row in enumerate(rows.tolist()):
        told = {n: Estimate(n, v, 0.01, "", Status.VALID, 0.0) for n, v in zip(names, row, strict=True)}
        watch.update(1.0, told)
        if hour % 6 and fault != "ratcheting":
            continue
        slips = {"ratcheting_events": told["ratcheting_events"]}
        for event in judge.judge(hour * 3600.0, slips, findings=watch.findings()).events:
            if event.severity is NE107.OK:
                continue
            judge.acknowledge(hour * 3600.0)
            if not fault or hour < START_H:
                false += 1
            elif np.isnan(delay):
                delay, right = hour - START_H, ("ratcheted" if fault == "ratcheting" else fault) in event.message
    return false, delay, right


def faults(years: int = YEARS) -> list[Row]:
    rng = np.random.default_rng(SEED)
    healthy = [_alarms(rng, "", 0.0)[0] for _ in range(years)]
    rows = [Row(f"false alarms per drive-year, {years} healthy years", float(np.mean(healthy)), "1/a", 1.0)]
    for fault in FAULTS:
        seen = [_alarms(rng, fault, size) for size in (1 / 3, 1.0, 5 / 3) for _ in range(max(years // 5, 2))]
        delays = [delay for _, delay, _ in seen]
        right = float(np.mean([named for _, _, named in seen]))
        found = f"found {np.mean(np.isfinite(delays)):.0%}, delay {np.nanmedian(delays):.0f} h"
        rows.append(Row(f"{fault}: right pattern at the first alarm, {len(seen)} gears", right, "1", 0.9, True, found))
    return rows


def cycles() -> list[Row]:
    rng = np.random.default_rng(SEED)
    n = 1_000_000
    torque = 40 * np.sin(np.arange(n) * 2 * np.pi / 500) + rng.normal(size=n)
    counter = CycleCounter(0.052)
    began = time.perf_counter()
    for start in range(0, n, 100):
        counter.update(torque[start : start + 100])
    spent = time.perf_counter() - began
    return [Row("rainflow, blocks of 100 noisy samples", 1e6 * spent / n, "us per sample", 1.0)]


def law(fleets: int = FLEETS) -> list[Row]:
    """The damage law's constants, learned from 25 histories of each fleet, against those that made them."""
    rng = np.random.default_rng(SEED)
    ultimate = GEAR.buckling_Nm or GEAR.momentary_peak_Nm or 4.0 * GEAR.rated_torque_Nm
    held: dict[str, list[bool]] = {"m": [], "gamma": [], "log_C": [], "scatter": []}
    for _ in range(fleets):
        truth = draw_constants(rng, ultimate)
        told = learn_law(GEAR, [FailedGear(*run_by_constants(rng, truth, ultimate)) for _ in range(25)])
        for name, inside in held.items():
            low, high = told.interval(name)
            inside.append(low <= getattr(truth, name) <= high)
    share = {name: float(np.mean(inside)) for name, inside in held.items()}
    each = ", ".join(f"{name} {value:.2f}" for name, value in share.items())
    name = f"learned law: constants within their 90 % intervals, {fleets} fleets"
    return [Row(name, float(np.mean(list(share.values()))), "1", 0.85, True, each)]


def rows() -> list[Row]:
    """Everything; some minutes."""
    return [*cycles(), *law(), *faults(), *forecasts(), *failures(), *unlike()]


def main(arguments: Sequence[str]) -> None:
    if arguments[:1] == ["failures"]:
        gears = int(arguments[1]) if arguments[1:] else FAILED_GEARS
        taught = (int(arguments[2]),) if arguments[2:] else FAILED_TAUGHT
        for row in failures(gears, taught, arguments[3:] or OWN_LAWS):
            print(" | ".join(cells(row)), flush=True)
        return
    gears = int(arguments[0]) if arguments else GEARS
    families = [arguments[1]] if len(arguments) > 1 else ALL
    for family in families:
        for row in forecasts(gears, family):
            print(" | ".join(cells(row)), flush=True)


if __name__ == "__main__":
    print(" | ".join(HEAD))
    main(sys.argv[1:])
