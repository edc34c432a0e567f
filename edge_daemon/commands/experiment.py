"""`experiment`: the machine makes the motion that its diagnosis plans, and diagnoses again, until one cause is left.

Every motion is guarded as `excite` guards any, and a person who has seen its table consents to it.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import termios
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from msgspec import structs

from edge_daemon.commands.excite import (
    ENDED_EARLY,
    ExciteTask,
    Pace,
    check_on_paper,
    excited_drive,
    make,
    outcome_words,
)
from edge_daemon.commands.recordings import read_told
from edge_daemon.config.reading import load
from edge_daemon.config.settings import Drive, Excite, Profile, Settings
from edge_daemon.effects.model_file import read_model
from edge_daemon.errors import BadInput
from edge_daemon.excite.arming import NotArmed, arm
from edge_daemon.excite.limits import PLANNED_SHARE, most_of
from edge_daemon.excite.profiles import fastest_tone_hz, planned_motion
from edge_daemon.explain.closed_loop import ClosedLoop, Step, doubt_bits, expected_bits, named
from edge_daemon.explain.plan import MotionLimits
from edge_daemon.explain.results import Diagnosis, Experiment, Json
from edge_daemon.recordings.recording import Recording
from edge_daemon.service.column_check import check_columns
from edge_daemon.text import number, written_as_json

FIRST_TONE_HZ = 3.7
"""A first look is one tone of this frequency: fast enough to load a spring, slow enough for any servo (guess)."""
FIRST_SHARE = 1 / 3
"""It takes this share of what the limits allow, since nobody has heard this gear yet (guess)."""
FADE_S = 0.5
SHORTEST_S = 8.0
"""A diagnosis needs seven and a half seconds of motion, and the filters take their share of the ends."""
ALIKE = 1e-3
"""Where a motion is as large as the limits allow, it is made smaller by this share against rounding."""


class MotionEnded(BadInput):
    """One line: why a motion ended before its time. Nothing moves after it."""


@dataclass(slots=True)
class Bench:
    """One drive that may be moved, and who consents."""

    settings: Settings
    base: Path
    drive: Drive
    it: Excite
    out: Path
    """folder of the recordings"""
    typed: Callable[[str], str | None]
    """a drive's name -> what the person types when asked for it"""
    pace: Pace
    seconds: float | None = None
    hold: bool = False
    made: int = 0

    def first_look(self) -> Recording:
        """One careful tone."""
        seconds = self.seconds or 12.0
        print(f"first look: one tone of {FIRST_TONE_HZ:g} Hz at a third of what the limits allow, {seconds:g} s")
        whole = Profile(
            name="first", kind="sine", speed_rad_s=self.it.limits.speed_rad_s, seconds=seconds, fade_s=FADE_S,
            frequency_hz=(min(FIRST_TONE_HZ, fastest_tone_hz(self.it.cycle_s)),),
        )  # fmt: skip
        return self.move(within_limits(whole, self.it, FIRST_SHARE))

    def follow(self, plan: Experiment) -> Recording:
        """A motion that was planned."""
        return self.move(within_limits(profile_of(plan, self.seconds), self.it))

    def move(self, profile: Profile) -> Recording:
        """Checked on paper, consented to, guarded, recorded. Raises `BadInput`."""
        motion = planned_motion(profile, self.it.cycle_s)
        check_on_paper(motion, self.it)
        task = ExciteTask(arm(self.drive, self.typed(self.drive.name)), self.drive, motion, self.settings, self.base)
        path = self.out / f"motion-{self.made + 1}.csv"
        outcome = make(task, self.hold, path, self.pace)
        if not outcome.completed:
            raise MotionEnded(outcome_words(outcome))
        if not path.exists():
            raise MotionEnded("no channel of the drive was heard")
        self.made += 1
        return read_told(path)


def experiment(arguments: argparse.Namespace) -> int:
    """0 where it came to its end, 1 where a motion ended early or was not consented to. Raises `BadInput` before
    anything moves."""
    if arguments.effect:
        raise BadInput("--effect: expected only with --demo: a real gear has what it has")
    return command(arguments, arguments.config, typed_name, Pace())


def command(arguments: argparse.Namespace, file: Path, typed: Callable[[str], str | None], pace: Pace) -> int:
    """The whole inquiry. `file` is the configuration."""
    if arguments.most < 1:
        raise BadInput(f"--most {arguments.most}: expected 1 or more")
    if arguments.seconds is not None and not arguments.seconds >= SHORTEST_S:
        raise BadInput(f"--seconds {arguments.seconds:g}: expected at least {SHORTEST_S:g}")
    settings = load(file)
    drive, it = excited_drive(settings, file, arguments.drive)
    if not it.allowed:
        arm(drive, None)
    model = read_model(file.parent / drive.model)
    with _folder(arguments.out) as out, _quiet(arguments.json == "-"):
        bench = Bench(settings, file.parent, drive, it, out, typed, pace, arguments.seconds, arguments.hold)
        recordings = [read_told(path) for path in arguments.recording] or [bench.first_look()]
        check_columns(model.balance, recordings)
        loop = ClosedLoop(model, [*recordings], motion_limits(it, model.ratio, model.output_inertia_kg_m2))
        print(_state(loop.found))
        stopped = _inquire(loop, bench, arguments.most)
        ending = stopped or loop.ending
        print(f"end: {ending}")
    written_as_json(document(loop, ending, bool(stopped)), arguments.json)
    return ENDED_EARLY if stopped else 0


def _inquire(loop: ClosedLoop, bench: Bench, most: int) -> str:
    """Motion after motion, each told; why it stopped before its end, or nothing."""

    def move(plan: Experiment) -> Recording:
        print(f"\nmotion {len(loop.steps) + 1} of at most {most}: {_expected(loop.found, plan)}")
        return bench.follow(plan)

    try:
        for step in loop.follow(move, most):
            print(_learned(step))
    except (NotArmed, MotionEnded) as error:
        return str(error)
    return ""


def document(loop: ClosedLoop, ending: str, stopped: bool) -> Json:
    """What `--json` writes."""
    return {
        "cause": named(loop.found),
        "ending": ending,
        "stopped": stopped,
        "motions": [step.to_json() for step in loop.steps],
        "diagnosis": loop.found.to_json(),
    }


# what a drive may do, as the planner and the profile know it


def motion_limits(it: Excite, ratio: float, inertia_kg_m2: float) -> MotionLimits:
    """The limits of the configuration on the output side."""
    limits = it.limits
    acceleration = PLANNED_SHARE * min(limits.acceleration_rad_s2, limits.torque_Nm / limits.inertia_kg_m2)
    return MotionLimits(
        motor_speed_rad_s=PLANNED_SHARE * limits.speed_rad_s,
        torque_Nm=inertia_kg_m2 * acceleration / abs(ratio),
        travel_rad=PLANNED_SHARE * limits.travel_rad / abs(ratio),
        tone_hz=fastest_tone_hz(it.cycle_s),
    )


def profile_of(plan: Experiment, seconds: float | None = None) -> Profile:
    """A planned motion as a profile of the runner."""
    return Profile(
        name="planned",
        kind="multi_tone",
        speed_rad_s=sum(plan.speeds_in_rad_s),
        seconds=seconds or plan.seconds,
        frequency_hz=plan.tones_hz,
        share=plan.speeds_in_rad_s,
        fade_s=FADE_S,
    )


def within_limits(profile: Profile, it: Excite, share: float = 1.0) -> Profile:
    """The profile, slowed where its fades or phases would pass a limit; at most that share of what is allowed."""
    needs = most_of(planned_motion(profile, it.cycle_s), it.limits)
    allowed = share * (1.0 - ALIKE) * min(PLANNED_SHARE * limit / needed for _, needed, limit in needs)
    return structs.replace(profile, speed_rad_s=profile.speed_rad_s * min(1.0, allowed))


# the person, the folder, and the words


def typed_name(name: str) -> str:
    """What is typed when asked for a drive's name; what was typed before the question does not count."""
    if sys.stdin.isatty():
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    print(f"type {name} to make this motion, anything else to end: ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip()


@contextlib.contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    if out is None:
        with tempfile.TemporaryDirectory(prefix="edge-daemon-experiment-") as folder:
            yield Path(folder)
        return
    if out.exists() and any(out.glob("motion-*")):
        raise BadInput(f"--out {out}: holds motions already: expected a new folder")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"--out {out}: cannot write: {error.strerror}: nothing was moved") from error
    yield out


@contextlib.contextmanager
def _quiet(json_only: bool) -> Iterator[None]:
    """Sentences on standard error where standard output belongs to JSON."""
    with contextlib.redirect_stdout(sys.stderr) if json_only else contextlib.nullcontext():
        yield


def _state(found: Diagnosis) -> str:
    rows = [f"{row.effect} {row.probability:.2f}" for row in found.candidates[:3]]
    return f"{found.verdict}: {', '.join(rows) or 'nothing stands out'}; {number(doubt_bits(found), 2)} bits of doubt"


def _expected(found: Diagnosis, plan: Experiment) -> str:
    what = (
        f"to tell {' from '.join(plan.separates)}" if plan.separates else "since one tone shows too little to judge by"
    )
    ratio = f", the wrong one erring {plan.separation:.3g} times as much" if plan.separates else ""
    return f"{plan.motion}, {what}; expected to tell up to {number(expected_bits(found, plan), 2)} bits{ratio}"


def _learned(step: Step) -> str:
    return f"learned {number(step.learned_bits, 2)} bits; {_state(step.after)}"
