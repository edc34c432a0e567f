"""`tools/vm build | test [short|full] | table | shell`."""

from __future__ import annotations

import argparse
import fcntl
import json
import math
import signal
import sys
import time
from dataclasses import dataclass

from field import cases, power, record
from field.image import CannotBuild, build, cache
from field.machine import GuestError, Machine, NoMachine, running
from field.share import LEAST, Share

CUTS = {"short": 3, "full": 50}
RESULTS = "results.json"
NOTE = "seconds of restart are those of an emulated processor, many times slower than the computer under it"


@dataclass(slots=True)
class Line:
    """Of the table."""

    name: str
    problem: str
    lost_s: float | None = None
    restart_s: float | None = None
    span_s: tuple[float, float] | None = None
    """of the guest's clock, where what the store lacks is to be counted"""
    share: float = 1.0
    """of a processor that the computer gave us meanwhile"""
    grave: bool = False
    """what is in the store is wrong: no busy computer excuses that"""

    @property
    def verdict(self) -> str:
        """yes, no, or starved: nothing is known."""
        if not self.problem:
            return "yes"
        return "no" if self.grave or self.share >= LEAST else "starved"

    def __str__(self) -> str:
        lost, restart = (f"{x:.1f}" if x is not None else "-" for x in (self.lost_s, self.restart_s))
        return f"{self.name:44} {self.verdict:8} {lost:>7} {restart:>9} {100 * self.share:>6.0f} %"


def main() -> int:
    """0: all survived; 1: one did not; 3: no machine can be had here, or it is starved."""
    parser = argparse.ArgumentParser(prog="tools/vm", description="The product in an emulated machine of its own.")
    parser.add_argument("what", choices=("build", "test", "table", "shell"))
    parser.add_argument("form", nargs="?", choices=("short", "full"), default="full")
    parser.add_argument("--cuts", type=int, help="power cuts (3 or 50)")
    parser.add_argument("--only", help="faults whose name contains this")
    given = parser.parse_args()
    if given.what == "table":
        print("\n".join(table(results())))
        return 0
    share = Share()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that what was begun is ended
    cache().mkdir(parents=True, exist_ok=True)
    with (cache() / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            return _done(Machine(build()), given, share)
        except (CannotBuild, NoMachine) as error:
            print(f"vm: left out: {error}")
            return 3
        except (GuestError, TimeoutError) as error:
            starved = share.since() < LEAST
            print(f"vm: {'left out, starved' if starved else 'FAILED'} ({100 * share.since():.0f} %): {error}")
            return 3 if starved else 1


def _done(machine: Machine, given: argparse.Namespace, share: Share) -> int:
    if given.what == "build":
        print(machine.folder)
        return 0
    if given.what == "shell":
        return shell(machine)
    faults = [row for row in cases.FAULTS if _asked(row, given.form, given.only)]
    return test(machine, share, faults, CUTS[given.form] if given.cuts is None else given.cuts)


def _asked(fault: cases.Fault, form: str, only: str | None) -> bool:
    return only in fault.name if only is not None else fault.short or form == "full"


def shell(machine: Machine) -> int:
    """Commands from the keyboard, until it ends."""
    with running(machine):
        while True:
            try:
                print(machine.run(input("gateway# "), 600.0).said, end="")
            except TimeoutError:
                print("no answer")
            except EOFError:
                return 0


def test(machine: Machine, share: Share, faults: list[cases.Fault], cuts: int) -> int:
    """All of them, the table, and 1 where something did not survive."""
    began_s = time.monotonic()
    lines = (_tried(machine, share, faults) if faults else []) + ([_cut(machine, share, cuts)] if cuts else [])
    _keep(lines)
    bad = [f"{line.name}: {line.problem}" for line in lines if line.problem]
    verdicts = {line.verdict for line in lines}
    print(f"\n{'fault':44} {'survived':8} {'lost s':>7} {'restart s':>9} {'share':>8}", *lines, NOTE, *bad, sep="\n")
    said = "FAILED" if "no" in verdicts else "left out, starved" if "starved" in verdicts else "passed"
    print(f"vm: {said} in {(time.monotonic() - began_s) / 60:.1f} minutes")
    return 1 if "no" in verdicts else 3 if "starved" in verdicts else 0


def results() -> dict[str, dict[str, float | str | None]]:
    """The newest verdict on each fault, by its name."""
    kept = cache() / RESULTS
    return dict(json.loads(kept.read_text())) if kept.exists() else {}


def _keep(lines: list[Line]) -> None:
    """For the table: a starved guest says nothing."""
    rows = results()
    for line in lines:
        if line.verdict != "starved":
            row = {"survived": line.verdict, "lost_s": line.lost_s, "restart_s": line.restart_s}
            rows[line.name] = {**row, "on": time.strftime("%Y-%m-%d")}
    (cache() / RESULTS).write_text(json.dumps(rows, indent=1))


def table(rows: dict[str, dict[str, float | str | None]]) -> list[str]:
    """Of docs/field-tests.md: every fault, what the newest run of each gave, and the test that holds it without a
    machine."""

    def cell(value: float | str | None) -> str:
        return f"{value:.1f}" if isinstance(value, float) else value or ""

    head = ["| fault | survived | lost s | restart s | on | also held by |", "|---|---|---|---|---|---|"]
    held = {fault.name: fault.held for fault in cases.FAULTS} | {power.name(n): power.HELD for n in CUTS.values()}
    return head + [
        f"| {' | '.join([name, *(cell(row.get(key)) for key in ('survived', 'lost_s', 'restart_s', 'on')), held_by])} |"
        for name, held_by in held.items()
        for row in [rows.get(name, {"survived": "not tried"})]
    ]


def _tried(machine: Machine, share: Share, faults: list[cases.Fault]) -> list[Line]:
    """One machine goes through everything, and begins anew from its snapshot where it did not survive."""
    lines: list[Line] = []
    left = [fault for fault in faults if not fault.destroys] + [fault for fault in faults if fault.destroys]
    while left:
        with running(machine):
            bench = cases.Bench(machine)
            bench.well()
            while left:
                if left[0].destroys:
                    _account(machine, lines)
                lines.append(_one(bench, share, left.pop(0)))
                if lines[-1].problem:
                    break
            _account(machine, lines)
    return lines


def _account(machine: Machine, lines: list[Line]) -> None:
    """What the store lacks of the times in which something went wrong, and whether what it has can be true."""
    waiting = [line for line in lines if line.span_s and line.lost_s is None]
    if not waiting:
        return
    machine.do(f"sleep {power.COMMIT_S}; sync")
    record.copy(machine.folder / "data.qcow2", machine.folder)
    kept = record.read(record.taken(machine.folder))
    for line in waiting:
        line.lost_s = kept.lost_s(*line.span_s or (0.0, 0.0))
    if damage := kept.damage():
        waiting[-1].problem, waiting[-1].grave = "; ".join(filter(None, (waiting[-1].problem, damage))), True


def _one(bench: cases.Bench, share: Share, fault: cases.Fault) -> Line:
    restart_s, problem, then = None, "", share.now
    bench.began_s = begin_s = bench.machine.run("true").time_s
    try:
        restart_s = fault.case(bench)
        if not fault.destroys:
            bench.well()
    except (GuestError, TimeoutError) as error:
        problem = str(error) or type(error).__name__
    span_s = (begin_s, bench.machine.run("true").time_s) if fault.counted else None
    print(f"{fault.name}: {problem or 'survived'}", flush=True)
    if problem:
        print(bench.machine.run(f"journalctl -u {cases.UNIT} -o short-monotonic -n 12 --no-pager").said, flush=True)
    return Line(fault.name, problem, None, restart_s, span_s, share.since(then))


def _cut(machine: Machine, share: Share, number: int) -> Line:
    """The worst of them in one line."""
    seed, then = int(time.time()), share.now
    try:
        cuts = power.cuts(machine, number, seed)
    except (GuestError, TimeoutError) as error:
        return Line(power.name(number), str(error) or type(error).__name__, share=share.since(then))
    bad = [row.problem for row in cuts if row.problem]
    worst_s = max((row.lost_s for row in cuts if math.isfinite(row.lost_s)), default=None)
    problem = f"{len(bad)} (seed {seed}): {'; '.join(bad[:5])}" if bad else ""
    grave = any(row.grave for row in cuts)
    return Line(power.name(number), problem, worst_s, share=share.since(then), grave=grave)


if __name__ == "__main__":
    sys.exit(main())
