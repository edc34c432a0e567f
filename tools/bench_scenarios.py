"""Live truth: what the daemon says while a sensor lies, the gear changes or the model is changed.

.venv/bin/python tools/bench_scenarios.py [WORD ...]      only the scenarios whose name holds one of the words

Each scenario goes on from one commissioned drive: something goes wrong, lasts a while, and ends. Everything runs in
simulated time through the chain that the daemon runs; two faults run end to end on the daemon and the rig process.
"""

from __future__ import annotations

import asyncio
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

from bench_row import HEAD, Row, cells  # noqa: E402

from edge_daemon.demo.gateway import prepare  # noqa: E402
from edge_daemon.records import NE107  # noqa: E402
from edge_daemon.rig.child import RigProcess  # noqa: E402
from edge_daemon.rig.faults import planned  # noqa: E402
from edge_daemon.rig.i2c_face import open_bus  # noqa: E402
from edge_daemon.service.daemon import Daemon  # noqa: E402
from edge_daemon.text import table  # noqa: E402
from tests.service.scenario import COMPLETE, OF_THE_GEAR, Look, Scene, model_text, resting, scene, shaken  # noqa: E402

COMMISSIONED_S = 45.0
"""When things go wrong [s]: the baseline is learned by then."""
LASTS_S = 15.0
"""How long a fault lasts that ends [s]."""
AFTER_S = 25.0
"""How long the drive is followed after the end [s]: what is not right again by then counts as never."""
RIGHT_S = 6.0
"""A drive that has been right for so long after the end is followed no further [s]."""
TOLD_WITHIN_S = 3.0
"""The longest that a fault which does harm may go unsaid [s]."""
HARMED_S = 3.0
"""A stiffness that is not usable for longer than this makes a fault one that must be told [s]."""
SOUND_HEALTH = 0.9
"""A health index below this calls a gear worn."""
HALF = 0.5
"""Of a real change, which must be seen for it to count as found."""
WEAR_LIMITS_S = {"wear:1%": 6.0, "wear:3%": 6.0, "wear:10%": 6.0}
"""Real wear is found again within a few seconds: 1.5 to 4 s were measured [s]."""
MODEL_WITHOUT = COMPLETE[:-1]


RESTED_S = 8.0
"""So long after the beginning something happens in a rest [s]: nothing has been watched then for seven seconds."""
STAYS = ("backlash", "friction", "payload", "weight")
"""Faults that could be undone, but are of the gear or the machine."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """What goes wrong; `fault` as `demo --fault` takes it without its time, or the model's effects from then on."""

    name: str
    fault: str = ""
    effects: tuple[str, ...] = COMPLETE
    becomes: tuple[str, ...] = ()
    again: tuple[str, ...] = ()
    """the model after the end"""
    lasts_s: float = LASTS_S
    of_the_gear: bool = False
    """it happens to the gear or the machine, and the sensors tell the truth"""
    more: str = ""
    """a fault that happens beside it"""
    rests: bool = False
    """whether the drive stands still meanwhile, from a second after its beginning"""
    shaken: tuple[str, ...] = ()
    """signals whose packets are stamped by a millisecond too early or too late now and then"""


def _of_either_encoder(*faults: str) -> Iterable[Scenario]:
    for fault in faults:
        name, _, size = fault.partition(":")
        for suffix in ("", "_in"):
            text = f"{name}{suffix}" + (f":{size}" if size else "")
            yield Scenario(text, text)


def _alone(*faults: str, of_the_gear: bool = False) -> Iterable[Scenario]:
    return (Scenario(fault, fault, of_the_gear=of_the_gear) for fault in faults)


def _without_friction(*faults: str) -> Iterable[Scenario]:
    """On the demonstration's own model, which lacks the gear's dry friction."""
    return (Scenario(f"{fault}, model incomplete", fault, effects=MODEL_WITHOUT) for fault in faults)


BOTH_SIGNALS = ("EncoderIn1.Position", "EncoderOut1.Position")
STAMPED_S = 1e-3
"""By so much stamps jump [s]: a whole sample."""
ASIDE = (
    "scaled:0.01%",
    "scaled:100%",
    "clock_drift:100ppm",
    "repeated:20%",
    "repeated:90%",
    "bit_errors:1%",
    "bursts:300",
    "eccentric",
    "dropped:30%",
)
"""Faults that were not looked at while the first were put right."""

SCENARIOS: tuple[Scenario, ...] = (
    Scenario("nothing goes wrong"),
    *_of_either_encoder(
        "frozen",
        "stuck_bit:6",
        "stuck_bit:12",
        "scaled:0.1%",
        "scaled:2%",
        "offset",
        "latch_shift:0.05ms",
        "latch_shift:0.3ms",
        "latch_shift:3ms",
        "dropped:1%",
        "dropped:10%",
        "dropped:50%",
        "coarse:4",
        "coarse:8",
        "noisy:30",
        "sign_flipped",
        "reset",
    ),
    *_of_either_encoder(*ASIDE),
    *_alone("exchanged", "torque_lag:5ms", "torque_scaled:20%", "torque_limited:0.05Nm", "temperature_off:30K"),
    Scenario("gap of 2 s", "silent", lasts_s=2.0),
    Scenario("gap of 15 s", "silent"),
    Scenario("effect added", effects=MODEL_WITHOUT, becomes=COMPLETE),
    Scenario("effect removed and added again", becomes=MODEL_WITHOUT, again=COMPLETE),
    *_alone("wear:1%", "wear:3%", "wear:10%", "backlash:20urad", "backlash:50urad", "friction:0.3Nm", of_the_gear=True),
    *_alone("weight:5Nm", "payload:10%", of_the_gear=True),
    *_without_friction("frozen", "scaled_in:2%", "latch_shift:0.3ms", "latch_shift_in:0.3ms", "exchanged", "silent"),
    Scenario("wear:3%, model incomplete", "wear:3%", effects=MODEL_WITHOUT, of_the_gear=True),
    *_of_either_encoder("sticking_bit:5"),
    *_alone("wearing:1%", "wearing:0.1%", of_the_gear=True),
    Scenario("rest of a minute", lasts_s=60.0, rests=True),
    Scenario("wear:3% in a rest", "wear:3%", lasts_s=60.0, rests=True, of_the_gear=True),
    Scenario("latch_shift_in:0.1ms in a rest", "latch_shift_in:0.1ms", rests=True),
    Scenario("stamps of both jump", shaken=BOTH_SIGNALS),
    Scenario("stamps of theta_in jump (_in)", shaken=BOTH_SIGNALS[:1]),
    *(
        Scenario(f"{fault} while a model is tried", fault, becomes=MODEL_WITHOUT, again=COMPLETE, lasts_s=5.0)
        for fault in ("scaled_in:0.1%", "latch_shift:0.3ms", "frozen_in")
    ),
    Scenario(
        "wear:3% while a model is tried",
        "wear:3%",
        becomes=MODEL_WITHOUT,
        again=COMPLETE,
        lasts_s=5.0,
        of_the_gear=True,
    ),
    Scenario("repeated_in:10% and latch_shift:0.1ms", "repeated_in:10%", more="latch_shift:0.1ms"),
    Scenario("wear:3% behind dropped:30%", "dropped:30%", more="wear:3%", of_the_gear=True),
)


@dataclass(frozen=True, slots=True)
class Course:
    """What was said from the moment when something went wrong."""

    scenario: Scenario
    before: Look
    looks: list[Look]
    ends_s: float

    @property
    def standing(self) -> Mapping[str, float]:
        """What was wrong before anything went wrong; the first scenario counts that."""
        return self.before.standing() if self.scenario.name != SCENARIOS[0].name and not self.scenario.becomes else {}

    @property
    def wrong(self) -> dict[str, int]:
        """Readings that were called usable and were not true, by quantity."""
        found: dict[str, int] = {}
        for look in self.looks:
            for name in look.wrong(self.standing):
                found[name] = found.get(name, 0) + 1
        return found

    @property
    def told_s(self) -> float:
        """From the beginning to the first word about it, of a sensor's fault in the state; infinite for none."""
        by_event = self.scenario.of_the_gear or not self.scenario.fault
        told = (look.time_s for look in self.looks if look.state is not NE107.OK or (by_event and look.said))
        return next(told, math.inf) - COMMISSIONED_S

    @property
    def named(self) -> bool:
        """Whether what was said names the channel."""
        channel = "theta_in" if "_in" in self.scenario.name else "theta_out"
        return any(channel in text for look in self.looks for text in look.said)

    @property
    def harms(self) -> bool:
        """Whether somebody must be told: a number was wrong, or the stiffness was not known for a while."""
        lost = sum(not look.usable("stiffness") for look in self.looks if look.time_s <= self.ends_s)
        return bool(self.wrong) or lost * (self.looks[0].time_s - self.before.time_s) > HARMED_S

    @property
    def last_wrong_s(self) -> float:
        """When something was last wrong or missing."""
        needed = OF_THE_GEAR if self.scenario.becomes else self.before.valid()
        wrong = (look.time_s for look in reversed(self.looks) if not look.right(self.standing, needed))
        return next(wrong, -math.inf)

    @property
    def right_s(self) -> float:
        """From its end to where all is right for good; of what does not end, from its beginning."""
        last = self.last_wrong_s
        if last >= self.looks[-1].time_s:
            return math.inf
        lasting = self.scenario.fault and planned(self.scenario.fault).fault.end is None
        return max(0.0, last - (COMMISSIONED_S if lasting or self.scenario.of_the_gear else self.ends_s))

    @property
    def found_s(self) -> float:
        """From a real change of stiffness to where the estimate is nearer to the new truth than to the old for good."""
        old, new = self.before.truth["stiffness"], self.looks[-1].truth["stiffness"]
        far = [
            look.time_s
            for look in self.looks
            if not look.usable("stiffness") or abs(look.estimates["stiffness"].value - new) > HALF * abs(new - old)
        ]
        return max(far, default=COMMISSIONED_S) - COMMISSIONED_S if far[-1:] != [self.looks[-1].time_s] else math.inf

    @property
    def contradictions(self) -> int:
        """Looks at which a drive stood as well beside a model that explains nothing of its torque."""
        errors = [
            look for look in self.looks if look.usable("model_nrmse") and look.estimates["model_nrmse"].value > 1.0
        ]
        return sum(look.state is NE107.OK for look in errors)

    @property
    def least_health(self) -> float:
        """The lowest health index that was published as usable."""
        return min(
            (look.estimates["health_index"].value for look in self.looks if look.usable("health_index")), default=1.0
        )

    @property
    def worst(self) -> str:
        """The quantity that was furthest from the truth, and by how many of its standard deviations."""
        off = [
            (look.off_sd(name, self.standing.get(name, 0.0)), name)
            for look in self.looks
            for name in look.wrong(self.standing)
        ]
        return f"worst {max(off)[1]} {max(off)[0]:.0f} sd" if off else ""

    def text(self) -> str:
        """Its other figures in one line."""
        parts = [
            f"told {self.told_s:.1f} s" if self.told_s < math.inf else "not told",
            "channel named" if self.named else "",
            f"right again {self.right_s:.1f} s" if self.right_s < math.inf else "not right again",
            f"health {self.least_health:.2f}" if self.least_health < SOUND_HEALTH else "",
            self.worst,
        ]
        return ", ".join(filter(None, parts))


def played(scenario: Scenario, start: Scene, before: Look) -> Course:
    """The scenario from a commissioned drive on."""
    it, begin_s, ends_s = start.fork(), COMMISSIONED_S, COMMISSIONED_S + scenario.lasts_s
    it.pipeline.model_file.write_text(model_text(scenario.effects))
    it.pipeline.follow_model(before.time_s)
    for text in filter(None, (scenario.fault, scenario.more)):
        fault = planned(text)
        fault.begin_s = begin_s + (RESTED_S if scenario.rests else 0.0)
        fault.end_s = math.inf if fault.fault.end is None or fault.fault.name in STAYS else ends_s
        it.plan.append(fault)
    if scenario.rests:
        it.drive.motion = resting(it.drive.motion, begin_s + 1.0, ends_s - 1.0)
        it.drive.plant.sound = -1  # nothing of it is on the tape
    if scenario.shaken:
        it = shaken(it, scenario.shaken, STAMPED_S, (begin_s, ends_s))
    if scenario.becomes:
        it.models = [(begin_s, scenario.becomes), *([(ends_s, scenario.again)] if scenario.again else [])]
    course = Course(scenario, before, [], ends_s)
    for look in it.run(ends_s + AFTER_S):
        course.looks.append(look)
        if look.time_s > ends_s + RIGHT_S and look.time_s > course.last_wrong_s + RIGHT_S:
            break
    return course


def courses(words: Sequence[str] = ()) -> Iterable[Course]:
    """Every scenario whose name holds one of the words, or all."""
    wanted = [row for row in SCENARIOS if not words or any(word in row.name for word in words)]
    for effects in dict.fromkeys(row.effects for row in wanted):
        with tempfile.TemporaryDirectory() as folder:
            start = scene(Path(folder), effects)
            *_, before = start.run(COMMISSIONED_S)
            for row in wanted:
                if row.effects == effects:
                    yield played(row, start, before)


def _of(course: Course) -> Row:
    return Row(course.scenario.name, sum(course.wrong.values()), "wrong readings", 0, peer=course.text())


def _counted(name: str, found: Sequence[Course], limit: float = 0) -> Row:
    return Row(name, len(found), "scenarios", limit, peer=" ".join(course.scenario.name for course in found))


def summary(found: Sequence[Course]) -> list[Row]:
    """What all scenarios together come to."""
    faults = [c for c in found if c.scenario.fault or c.scenario.becomes or c.scenario.shaken]
    sensors = [course for course in faults if course.scenario.fault and not course.scenario.of_the_gear]
    wear = [course for course in found if course.scenario.name in WEAR_LIMITS_S]
    unnamed = [c for c in sensors if c.harms and not c.named and c.scenario.name not in ("exchanged", "gap of 15 s")]
    return [
        Row("scenarios", len(found), "1"),
        _counted("a usable number was wrong", [course for course in found if course.wrong]),
        _counted("harm not told within 3 s", [c for c in sensors if c.harms and c.told_s > TOLD_WITHIN_S]),
        _counted("harm told without the channel", unnamed),
        _counted("a model error above 1 beside ok", [course for course in found if course.contradictions]),
        _counted("not right again", [course for course in faults if course.right_s == math.inf]),
        _counted(
            "a sound gear called worn",
            [c for c in found if not c.scenario.of_the_gear and c.least_health < SOUND_HEALTH],
        ),
        _counted("told although nothing is wrong", [c for c in found if c not in faults and c.told_s < math.inf]),
        *(Row(f"{c.scenario.name} found", c.found_s, "s", WEAR_LIMITS_S[c.scenario.name]) for c in wear),
    ]


# the demonstration

ADDED_S, SEEN_S = 80.0, 180.0
"""When the effect that its model lacks is added, and when all must hold [s]."""


def demonstrated() -> list[Row]:
    """The right effect is added to the demonstration's model: nothing of a sound gear is lost by that."""
    with tempfile.TemporaryDirectory() as folder:
        it = scene(Path(folder), MODEL_WITHOUT, baseline_after_s=60.0)
        it.models = [(ADDED_S, COMPLETE)]
        looks = list(it.run(SEEN_S))
    last, after = looks[-1], [look for look in looks if look.time_s > ADDED_S]
    change, off = last.estimates["stiffness_change"], {n: last.off_sd(n) for n in last.truth if last.usable(n)}
    name = max(off, key=lambda row: off[row])
    health = [1.0 - look.estimates["health_index"].value for look in after if look.usable("health_index")]
    return [
        Row("effect added at 80 s: health lost", max(health), "1", 0.03, peer="the most until 180 s"),
        Row("stiffness change at 180 s", abs(change.value) / change.sd, "sd", 1.0, peer=change.status.value),
        Row("the valid number furthest off at 180 s", off[name], "sd", 4.0, peer=name),
    ]


# end to end

END_TO_END = ("frozen", "latch_shift_in:3ms")
LEARNED_WITHIN_S = 30.0
"""By when the daemon has to have a valid stiffness after its start [s], end to end."""


def end_to_end() -> list[Row]:
    """Time until told on the daemon with its real drivers, against the rig process in real time."""
    return [Row(f"{fault} told, end to end", asyncio.run(_told_s(fault)), "s", TOLD_WITHIN_S) for fault in END_TO_END]


async def _told_s(text: str) -> float:
    fault = planned(text)
    with tempfile.TemporaryDirectory() as folder, RigProcess() as rig:
        file = prepare(Path(folder), rig.ready, 1, free_ports=True)
        (file.parent / "axis.model.toml").write_text(model_text(COMPLETE))
        daemon = Daemon(file, i2c_bus=lambda name: open_bus(str(name)))
        running = asyncio.create_task(daemon.run())
        try:
            if math.isinf(await _until(lambda: _is_calm(daemon), LEARNED_WITHIN_S)):
                return math.nan  # a machine too busy to play the drive in real time
            rig.order(drive=1, fault=fault.fault.name, **({"size": fault.size} if fault.fault.unit else {}))
            return await _until(lambda: not _is_calm(daemon), LEARNED_WITHIN_S)
        finally:
            daemon.stop()
            await running


def _is_calm(daemon: Daemon) -> bool:
    found = daemon.state().snapshots.get("axis-1")
    stiffness = found.estimates.get("stiffness") if found else None
    return found is not None and found.state is NE107.OK and stiffness is not None and stiffness.usable


async def _until(condition: Callable[[], bool], within_s: float) -> float:
    """Seconds until it holds; infinite if that takes longer."""
    begin_s = time.monotonic()
    while time.monotonic() - begin_s < within_s:
        if condition():
            return time.monotonic() - begin_s
        await asyncio.sleep(0.02)
    return math.inf


def rows(words: Sequence[str] = ()) -> list[Row]:
    """A row per scenario: readings called usable and wrong by more than five deviations; then what all come to."""
    found = list(courses(words))
    return [*map(_of, found), *summary(found), *([] if words else [*demonstrated(), *end_to_end()])]


if __name__ == "__main__":
    print(table(HEAD, map(cells, rows(sys.argv[1:]))))
