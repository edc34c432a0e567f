"""Broken bytes for every reader of what comes from outside: a traceback, a second of computing or a heap is a fault.

`fuzz.py [SECONDS] [TARGET...]` runs long, each target in turn for a share of the time; the tests run few inputs of
each. An input is a good example that was damaged: bits flipped, pieces cut, copied or exchanged, numbers replaced by
those that programs forget. What is refused is refused with `BadInput`, in one line.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from edge_daemon.acquire.can_decode import Layout
from edge_daemon.errors import BadInput
from edge_daemon.fleet.signed import signed

ROOT = Path(__file__).parent.parent
CONFIG = ROOT / "config"
DBC = ROOT / "edge_daemon" / "rig" / "drive.dbc"
MOST_CPU_S = 1.0
MOST_GROWTH_MIB = 400
NASTY = (
    *("nan", "-nan", "inf", "-1e308", "1e-320", "0", "-0.0", "-1", "1e400", "9" * 400, "0x10", "true", "null", "''"),
    *('"', "[", "]" * 40, "[" * 3000, "{", "}", "=", ",", ";", "\t", "\n", "\r\n", "#", "\0", "\x1b[31m", "\ufeff"),
    *("é", "𝛕", "\u202e", "../../etc/passwd", "%s%n", "__class__", "lambda: 0", "1**9**9", "(" * 200, "a" * 5000),
    *("2026-01-01", "1970-01-01T00:00:00Z", "-9223372036854775809", "18446744073709551616"),
)
NUMBER = re.compile(rb"-?\d+\.?\d*(?:e-?\d+)?")


@dataclass(frozen=True, slots=True)
class Target:
    """A reader, and good examples of what it reads."""

    examples: Callable[[], list[bytes]]
    read: Callable[[bytes, Path], object]
    ending: str = ""
    """of the file that is written for it; none where bytes are handed over"""


def damaged(rng: random.Random, example: bytes) -> bytes:
    """The example after one to six accidents."""
    data = bytearray(example)
    for _ in range(rng.randint(1, 6)):
        rng.choice(_ACCIDENTS)(rng, data)
    return bytes(data)


def _flip(rng: random.Random, data: bytearray) -> None:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _cut(rng: random.Random, data: bytearray) -> None:
    start = rng.randrange(len(data) + 1)
    del data[start : start + rng.choice((1, 2, 8, 64, len(data)))]


def _copy(rng: random.Random, data: bytearray) -> None:
    start = rng.randrange(len(data) + 1)
    piece = data[start : start + rng.choice((1, 4, 40, 400))]
    data[(at := rng.randrange(len(data) + 1)) : at] = piece * rng.choice((1, 1, 2, 50))


def _insert(rng: random.Random, data: bytearray) -> None:
    data[(at := rng.randrange(len(data) + 1)) : at] = rng.choice(NASTY).encode()


def _other_number(rng: random.Random, data: bytearray) -> None:
    found = list(NUMBER.finditer(data))
    if found:
        one = rng.choice(found)
        data[one.start() : one.end()] = rng.choice(NASTY).encode()


def _exchange_lines(rng: random.Random, data: bytearray) -> None:
    lines = bytes(data).split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[i], lines[j] = lines[j], lines[i]
    data[:] = b"\n".join(lines)


_ACCIDENTS = (_flip, _cut, _copy, _insert, _other_number, _other_number, _exchange_lines)


# examples


def _file_bytes(*names: str) -> Callable[[], list[bytes]]:
    return cache(lambda: [(CONFIG / name).read_bytes() for name in names])


@cache
def _recordings() -> list[bytes]:
    time_s = np.arange(400) / 1000.0
    rows = np.column_stack((time_s, 100 * np.sin(time_s), np.sin(time_s), 1e3 * np.cos(time_s)))
    text = "time_s,theta_in_rad,theta_out_rad,torque_out_Nm\n" + "\n".join(",".join(map(str, row)) for row in rows[:60])
    return [text.encode(), text.replace(".", "#").replace(",", ";").replace("#", ",").encode()]


@cache
def _parquet() -> list[bytes]:
    from edge_daemon.recordings.recording import write_recording

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "r.parquet"
        write_recording(file, np.arange(50) / 100.0, {"theta_out_rad": np.sin(np.arange(50))})
        return [file.read_bytes()]


@cache
def _histories() -> list[bytes]:
    head = "time_h,speed_in_rpm,torque_cubic_mean_Nm,torque_peak_Nm,temperature_degC,stiffness_Nm_per_rad,noise_a0\n"
    return [(head + "\n".join(f"{i},1500,{20 + i % 3},40,{30 + i % 5},{15000 - i},1e-4" for i in range(60))).encode()]


@cache
def _sounds() -> list[bytes]:
    import soundfile

    wave = io.BytesIO()
    soundfile.write(wave, 0.1 * np.random.default_rng(1).normal(size=8000), 8000, format="WAV")
    return [wave.getvalue()]


@cache
def _spectra() -> list[bytes]:
    frequency = np.arange(1, 200) * 5.0
    rows = "\n".join(f"{f},{1e-4 / f},40" for f in frequency)
    waves = "\n".join(f"{i / 1000},{np.sin(i)}" for i in range(300))
    return [f"frequency_hz,psd,averages\n{rows}".encode(), f"time_s,sound\n{waves}".encode()]


@cache
def _logs() -> list[bytes]:
    return ["".join(f"({1.7e9 + i / 1e3:.6f}) can0 {0x181 + i % 3:03X}#{i:016X}\n" for i in range(60)).encode()]


@cache
def _priors() -> list[bytes]:
    from simulated_failures import run_to_end

    from edge_daemon.prognose.learn import FailedGear, learn_life, prior_to_bytes
    from edge_daemon.usage.gears import find_gear

    rng = np.random.default_rng(3)
    lives = [run_to_end(rng, "creep") for _ in range(5)]
    gears = [FailedGear(life.time_h[::40], {n: v[::40] for n, v in life.columns.items()}) for life in lives]
    return [prior_to_bytes(learn_life(find_gear("CSG-20-100"), gears, rounds=1))]


@cache
def _blocks() -> list[bytes]:
    from edge_daemon.records import Block
    from edge_daemon.store.codec import BlockEncoder

    values = np.round(np.sin(np.arange(100) / 9.0) * 4e3) * 1e-4
    fine = np.zeros(100, dtype=np.uint8)
    block = Block("axis", 1, 1.7e9, 1e-3, {"theta_in_rad": values}, {"theta_in_rad": fine})
    return [BlockEncoder().encode([block] * 3)]


@cache
def _fleet_priors() -> list[bytes]:
    from edge_daemon.fleet.prior import FleetPrior

    laws = [[6.0, 7.5, 8.0], [2.0, 2.2, 1.9], [8.7, 8.8, 8.6]]
    return [FleetPrior("strainwave/prior", 1, "CSG-20-100", 7, 200, 80, *laws).to_bytes()]


@cache
def _messages() -> list[bytes]:
    from edge_daemon.publish.messages import Composer, birth
    from edge_daemon.records import NE107, Estimate, Event, Snapshot, Status

    rows = [
        Estimate("stiffness", 2.7e4, 12.0, "N m/rad", Status.VALID, 1.7e9),
        Estimate("damage", 0.1, 0.02, "1", Status.WARMING_UP, 1.7e9),
    ]
    composer = Composer(5, 0.0, time.monotonic)
    made = composer.of_snapshot(Snapshot("axis", 1, 1.7e9, NE107.OK, ("why",), {row.name: row for row in rows}))
    made = [*made, composer.of_event(Event("axis", 1.7e9, NE107.OK, "model", "now of linear_stiffness"))]
    made = [*made, composer.of_meta("axis", 1.7e9, birth(gear="CSG-20-100", model={"ratio": 100.0}, versions={}))]
    return [row.payload(historical=False) for row in made]


@cache
def _datasets() -> list[bytes]:
    from edge_daemon.fleet.dataset import Batch
    from edge_daemon.fleet.heard import heard, rows_beside

    batch, sink = Batch(0.0), io.BytesIO()
    for payload in _messages():
        batch.add("s/g/axis/stiffness", heard(payload), rows_beside("stiffness", heard(payload), payload))
    pq.write_table(batch.table(), sink, store_schema=False)
    return [sink.getvalue()]


@cache
def _lives() -> list[bytes]:
    from edge_daemon.prognose.life import LifeFollower
    from edge_daemon.records import Block
    from edge_daemon.usage.gears import find_gear

    follower = LifeFollower(find_gear("CSG-20-100"), "axis")
    turn, fine = np.linspace(0.0, 30.0, 100), np.zeros(100, dtype=np.uint8)
    values = {"theta_in_rad": turn, "theta_out_rad": turn / 100.0, "torque_out_Nm": 20.0 * np.sin(turn)}
    for i in range(20):
        follower.update(Block("axis", i, 1.7e9 + i, 0.01, values, dict.fromkeys(values, fine)), {})
    return [follower.state()]


MODEL = """[joint]
balance = "torsion"
ratio = 100.0
output_inertia_kg_m2 = 0.05
[[effect]]
name = "linear_stiffness"
[effect.parameters.stiffness]
value = 2.7e4
sd = 12.0
unit = "N m/rad"
identified = true
[[effect]]
name = "own"
expression = "a * sin(theta_in_rad) + b * abs(omega_out)"
[effect.parameters.a]
value = 1.0
"""
GEAR = """name = "own"
ratio = 100.0
rated_torque_Nm = 40.0
rated_speed_rpm = 2000.0
l10_h = 7000.0
l50_h = 35000.0
repeated_peak_Nm = 82.0
momentary_peak_Nm = 147.0
"""
FORMULAS = [
    "a * sin(2 * theta_in_rad + p) + b * abs(omega_out) ** 1.5",
    "a * exp(-twist / 1e-3)",
    "f * sign(twist_rate)",
]
DRAWING = """[flexspline]
kind = "cup"
mean_radius_mm = 25
length_mm = 30
wall_mm = [[0, 0.35], [20, 0.4]]
rim_width_mm = 10
rim_thickness_mm = 0.9
diaphragm_thickness_mm = 0.5
hub_radius_mm = 12
fillet_mm = 0.5
[teeth]
flexspline = 200
circular_spline = 202
module_mm = 0.25
profile = "involute"
[wave_generator]
shape = "ellipse"
radial_deflection_mm = 0.25
contact_width_mm = 3
[material]
name = "18Ni300"
[load]
torque_Nm = 50
speed_in_rpm = 2000
"""


# readers


def _file(read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    def run(data: bytes, file: Path) -> object:
        file.write_bytes(data)
        return read(file)

    return run


def _model(data: bytes, _: Path) -> None:
    from edge_daemon.effects.model_file import parse_model

    parse_model(data.decode("utf-8", "surrogateescape"))


def _formula(data: bytes, _: Path) -> None:
    from edge_daemon.effects.expression import parse

    parse(data.decode("utf-8", "surrogateescape"))


def _recording(file: Path) -> None:
    from edge_daemon.recordings.recording import read_recording

    read_recording(file)


def _mapped(data: bytes, file: Path) -> None:
    from edge_daemon.recordings.column_map import column_map

    names, _, formula = data.decode("utf-8", "replace").partition("|")
    column_map(names or None, [formula]).applied({"time_ms": np.arange(9.0), "x": np.arange(9.0)})


def _life(file: Path) -> None:
    from edge_daemon.prognose.history import usable
    from edge_daemon.recordings.recording import read_recording
    from edge_daemon.usage.gears import find_gear

    read = read_recording(file, time="time_h", least=1)
    usable(read.time_s, dict(read.columns), find_gear("CSG-20-100"))


def _sound(file: Path) -> None:
    from edge_daemon.sound.sound_file import fit_sound_file

    fit_sound_file(file)


def _configuration(file: Path) -> None:
    from edge_daemon.config.reading import load

    load(file)


def _gear(file: Path) -> None:
    from edge_daemon.usage.gears import find_gear

    find_gear(str(file))


def _layouts(file: Path) -> None:
    from edge_daemon.acquire.can_decode import dbc_layouts

    for layout in dbc_layouts(file):
        if layout.length:
            list(layout.decode(bytes(3 * layout.length)))


def _can_log(file: Path) -> None:
    from edge_daemon.acquire.replay import _log
    from edge_daemon.acquire.source import Tally

    for message in _log(file, Tally("fuzz")):
        bytes(message.data)


@cache
def _frames() -> dict[int, Layout]:
    from edge_daemon.acquire.can_decode import dbc_layouts

    return {layout.key: layout for layout in dbc_layouts(DBC)}


def _serial_line(data: bytes, _: Path) -> None:
    from edge_daemon.acquire.can_inbox import Inbox
    from edge_daemon.acquire.can_readers import SlcanReader
    from edge_daemon.acquire.source import Tally

    inbox = Inbox("can0", _frames(), (), Tally("fuzz"))
    end, other = os.pipe()
    try:
        os.write(other, data[:60_000])
        SlcanReader(end, inbox).drain(inbox, 1000)
        list(inbox.flush(0.0))
    finally:
        os.close(end)
        os.close(other)


def _prior(data: bytes, _: Path) -> None:
    from edge_daemon.prognose.learn import prior_from_bytes

    prior = prior_from_bytes(data)
    _foretold(lambda ledger: prior)


def _foretold(prior_at: Callable[[Any], Any]) -> None:
    """A forecast with this prior."""
    from edge_daemon.prognose.forecast import foresee
    from edge_daemon.usage.evidence import evidence_of
    from edge_daemon.usage.gears import find_gear
    from edge_daemon.usage.ledger import rows_of

    time_h = np.arange(1.0, 60.0)
    columns = {"speed_in_rpm": 1500.0 + 0 * time_h, "torque_cubic_mean_Nm": 20.0 + np.sin(time_h)}
    columns |= {"torque_peak_Nm": 40.0 + 0 * time_h, "stiffness_Nm_per_rad": 15000.0 - time_h}
    ledger = rows_of(find_gear("CSG-20-100"), time_h, np.ones_like(time_h), columns)
    left_h = foresee(find_gear("CSG-20-100"), ledger, evidence_of(ledger), prior_at(ledger)).remaining_h
    if not np.all(left_h >= 0.0):
        raise AssertionError(f"remaining life {left_h[:3]}")


def _fleet_prior(data: bytes, _: Path) -> None:
    """As a gateway that was given it by whoever has the key."""
    from edge_daemon.fleet.signed import opened, signed
    from edge_daemon.service.priors import DrivePrior
    from edge_daemon.usage.gears import find_gear

    key, prior = b"k" * 32, DrivePrior(find_gear("CSG-20-100"))
    envelope = signed(data, key)
    prior.offer(envelope, opened(envelope, key))
    _foretold(prior.at)


def _envelope(data: bytes, _: Path) -> None:
    from edge_daemon.fleet.signed import opened

    opened(data, b"k" * 32)


def _message(data: bytes, _: Path) -> None:
    """As a collector hears it, up to the rows of its file."""
    from edge_daemon.fleet.dataset import Batch, date_of
    from edge_daemon.fleet.heard import Unheard, heard, rows_beside

    with contextlib.suppress(Unheard):
        for topic in ("life", "event"):
            message, batch = heard(data), Batch(0.0)
            batch.add(f"s/g/axis/{topic}", message, rows_beside(topic, message, data))
            batch.table()
            batch.numbers()
            date_of(message.time_s)


def _dataset(file: Path) -> None:
    from edge_daemon.fleet.past import past_of_file

    past_of_file(file)


def _life_state(data: bytes, _: Path) -> None:
    from edge_daemon.prognose.life import LifeFollower
    from edge_daemon.usage.gears import find_gear

    follower = LifeFollower(find_gear("CSG-20-100"), "axis")
    with contextlib.suppress(
        ValueError, TypeError, LookupError, ArithmeticError, zlib.error
    ):  # the daemon begins anew then
        follower.restore(data)


def _drawing(file: Path) -> None:
    from edge_daemon.design.drawing import read_drawing

    read_drawing(file)


def _chunk(data: bytes, _: Path) -> None:
    from edge_daemon.store.codec import decode
    from edge_daemon.store.rows import DAMAGE

    with contextlib.suppress(*DAMAGE):  # the store tells these as a damaged row
        list(decode("axis", data))


def _arguments(data: bytes, _: Path) -> None:
    """What a person types, up to the first file that is missing."""
    from edge_daemon.cli import main

    words = data.decode("utf-8", "replace").replace("\0", "").split("\n")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as told:
        try:
            code = main(words)
        except SystemExit as ended:
            code = int(ended.code or 0)
    if code not in (0, 1, 2) or len(told.getvalue().strip().splitlines()) > 1:
        raise AssertionError(f"exit {code}: {told.getvalue()[:200]}")


TYPED = (
    *(b"keys\ndrive.channels", b"registers\n--format\ncsv", b"effects", b"life\n/no/file.csv\n--gear\nCSG-20-100"),
    *(
        b"compare\n/no/file.csv\n--model\n/no/model.toml",
        b"export\n--store\n/no/s.sqlite\n--out\n/no/f.csv\n--since\n2h",
    ),
)
TARGETS: dict[str, Target] = {
    "model file": Target(lambda: [MODEL.encode()], _model),
    "formula": Target(lambda: [formula.encode() for formula in FORMULAS], _formula),
    "recording": Target(_recordings, _file(_recording), ".csv"),
    "parquet": Target(_parquet, _file(_recording), ".parquet"),
    "column map": Target(lambda: [b"time_ms,x|time_s=time_ms*1e-3", b"|theta_out_rad=-x*pi/180"], _mapped),
    "history": Target(_histories, _file(_life), ".csv"),
    "sound": Target(_sounds, _file(_sound), ".wav"),
    "spectrum": Target(_spectra, _file(_sound), ".csv"),
    "configuration": Target(_file_bytes("demo.toml", "gateway.toml"), _file(_configuration), ".toml"),
    "gear": Target(lambda: [GEAR.encode()], _file(_gear), ".toml"),
    "DBC": Target(lambda: [DBC.read_bytes()], _file(_layouts), ".dbc"),
    "CAN log": Target(_logs, _file(_can_log), ".log"),
    "serial line": Target(lambda: [b"t1818%016X\r" % i * 3 for i in range(4)], _serial_line),
    "prior": Target(_priors, _prior),
    "fleet's prior": Target(_fleet_priors, _fleet_prior),
    "signed prior": Target(lambda: [signed(_fleet_priors()[0], b"k" * 32)], _envelope),
    "fleet's message": Target(_messages, _message),
    "fleet's dataset": Target(_datasets, _file(_dataset), ".parquet"),
    "life's checkpoint": Target(_lives, _life_state),
    "drawing": Target(lambda: [DRAWING.encode()], _file(_drawing), ".toml"),
    "stored blocks": Target(_blocks, _chunk),
    "command line": Target(lambda: list(TYPED), _arguments),
}


# running


class Fault(Exception):
    """What an input did that none may."""


def tried(target: Target, data: bytes, file: Path) -> str:
    """Whether the input was taken or refused. Raises `Fault`."""
    began_s, before = time.process_time(), _resident_mib()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            target.read(data, file)
        told = "taken"
    except BadInput as error:
        told = "refused"
        if "\n" in str(error) or not str(error):
            raise Fault(f"a refusal of more than one line: {str(error)[:300]!r}") from error
    except (Exception, RecursionError) as error:
        raise Fault("".join(traceback.format_exception(error)[-4:])) from error
    spent_s = time.process_time() - began_s
    if spent_s > MOST_CPU_S:
        raise Fault(f"{spent_s:.1f} s of computing")
    if _resident_mib() - before > MOST_GROWTH_MIB:
        raise Fault(f"{_resident_mib() - before:.0f} MiB")
    return told


def _resident_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(name: str, inputs: Iterator[int], folder: Path) -> Counter[str]:
    """Counts of what became of inputs with these seeds; faults are counted by what they say."""
    target, counts = TARGETS[name], Counter[str]()
    file = folder / f"input{target.ending}"
    examples = target.examples()
    for example in examples:
        tried(target, example, file)
    for seed in inputs:
        rng = random.Random(f"{name} {seed}")
        data = damaged(rng, rng.choice(examples))
        try:
            counts[tried(target, data, file)] += 1
        except Fault as fault:
            counts["fault"] += 1
            counts[f"seed {seed}: {fault}"] += 1
    return counts


def _for_seconds(seconds: float, first: int) -> Iterator[int]:
    end_s, seed = time.monotonic() + seconds, first
    while time.monotonic() < end_s:
        yield seed
        seed += 1


def main(arguments: list[str]) -> int:
    """Every target for its share of the time; exit 1 where there was a fault."""
    seconds = float(arguments[0]) if arguments else 60.0
    names = arguments[1:] or list(TARGETS)
    first, faults = int(os.environ.get("FUZZ_FIRST", "0")), 0
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            counts = run(name, _for_seconds(seconds / len(names), first), Path(folder))
            faults += counts["fault"]
            print(json.dumps({name: {key: counts[key] for key in ("taken", "refused", "fault")}}), flush=True)
            kinds = {text.splitlines()[-1]: text for text in counts if text.startswith("seed")}
            for text in kinds.values():
                print("   ", text.replace("\n", "\n    "), flush=True)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
