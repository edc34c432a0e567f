"""`init`: a configuration and a model for one drive, from answers to a few questions or from flags."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edge_daemon.acquire.can_decode import dbc_layouts
from edge_daemon.acquire.i2c_presets import PRESETS
from edge_daemon.channels import CHANNELS
from edge_daemon.commands.configuration_text import configuration, model_text
from edge_daemon.commands.questions import WORDS
from edge_daemon.errors import BadInput
from edge_daemon.service.configuration import examined
from edge_daemon.text import meant, write_text
from edge_daemon.usage.gears import find_gear

NONE = "-"
"""The answer that something is not there."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
TYPES = ("u16", "i16", "u32", "i32", "f32")
BUSES = ("canopen", "dbc", "simulated", NONE)
Answers = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Question:
    """One thing that is asked; `flag` is its name on the command line."""

    flag: str
    read: Callable[[str, Answers], Any]
    """raises ValueError, whose text says what was expected"""
    usual: Callable[[Answers], str] | None = None
    """None: there is no usual answer"""
    when: Callable[[Answers], bool] = field(default=lambda _: True)

    @property
    def form(self) -> str:
        """What an answer looks like."""
        return WORDS[self.flag][0]

    @property
    def asks(self) -> str:
        """The question itself."""
        return WORDS[self.flag][1]


def _name(text: str, _: Answers) -> str:
    if not NAME.fullmatch(text):
        raise ValueError("expected letters, digits and ._- (at most 64)")
    return text


def _gear(text: str, _: Answers) -> str | None:
    if text == NONE:
        return None
    return text if text.endswith(".toml") else find_gear(text).name


def _ratio_of_gear(answers: Answers) -> str:
    return f"{find_gear(answers['gear']).ratio:g}" if answers["gear"] else "100"


def _ratio(text: str, _: Answers) -> float:
    value = float(text)
    if not 1.0 < abs(value) < 1e6:
        raise ValueError("expected motor turns per output turn, such as 100, or -100 where the output turns against it")
    return value


def _positive(text: str, _: Answers) -> float:
    value = float(text)
    if not 0.0 < value < 1e12:
        raise ValueError("expected a number above 0")
    return value


def _bus(text: str, _: Answers) -> str | None:
    if text not in BUSES:
        raise ValueError(meant(text, BUSES))
    return None if text == NONE else text


def _place(text: str, _: Answers) -> tuple[str, str]:
    interface, colon, channel = text.partition(":")
    if not colon or not channel:
        raise ValueError("expected such as socketcan:can0 or slcan:/dev/ttyACM0")
    return interface, channel


def _encoder(text: str, _: Answers) -> tuple[int, int] | None:
    if text == NONE:
        return None
    found = re.fullmatch(r"(\d+):(\d+)", text)
    if not found or not 1 <= int(found[1]) <= 127 or not 8 <= int(found[2]) <= 40:
        raise ValueError("expected its node, 1 to 127, and its bits per turn, 8 to 40, such as 1:17")
    return int(found[1]), int(found[2])


def _servo(text: str, _: Answers) -> tuple[int, float, float | None] | None:
    if text == NONE:
        return None
    found = re.fullmatch(r"(\d+):([\d.]+)(?::(\d+))?", text)
    if not found or not 1 <= int(found[1]) <= 127 or float(found[2]) <= 0:
        raise ValueError("expected its node, rated torque [N m] and counts per motor turn, such as 3:0.64:65536")
    return int(found[1]), float(found[2]), float(found[3]) if found[3] else None


def _file(text: str, answers: Answers) -> str:
    dbc_layouts(answers["folder"] / text)
    return text


def _signals(answers: Answers) -> list[str]:
    layouts = dbc_layouts(answers["folder"] / answers["dbc"])
    return [row.name for layout in layouts for row in layout.fields]


def _like(*words: str) -> Callable[[Answers], str]:
    """The first signal of the DBC file whose name has one of each `a|b` in it."""

    def guessed(answers: Answers) -> str:
        found = [name for name in _signals(answers) if all(re.search(word, name, re.IGNORECASE) for word in words)]
        return found[0] if found else NONE

    return guessed


def _signal(text: str, answers: Answers) -> str | None:
    if text == NONE:
        return None
    known = _signals(answers)
    if text not in known:
        raise ValueError(f"{text!r} is no signal of {answers['dbc']}: {meant(text, known)}")
    return text


def _chip(text: str, _: Answers) -> tuple[int, str, int] | None:
    if text == NONE:
        return None
    found = re.fullmatch(r"(\d+):(\w+)(?::(?:0x)?([0-9a-fA-F]{2}))?", text)
    if not found:
        raise ValueError("expected bus, part and address, such as 1:bmp280:0x76")
    if found[2] not in PRESETS:
        raise ValueError(f"part {found[2]!r}: {meant(found[2], PRESETS)}")
    possible = PRESETS[found[2]].addresses
    address = int(found[3], 16) if found[3] else possible[0]
    if address not in possible:
        raise ValueError(f"address 0x{address:02x}: expected {' or '.join(f'0x{one:02x}' for one in possible)}")
    return int(found[1]), found[2], address


def _device(text: str, _: Answers) -> tuple[str, int] | None:
    if text == NONE:
        return None
    place, at, device = text.rpartition("@")
    good = place.startswith("/") or re.fullmatch(r"[^:\s]+:\d{1,5}", place)
    if not at or not good or not device.isdecimal() or not 1 <= int(device) <= 247:
        raise ValueError("expected HOST:PORT@ID or /dev/...@ID, such as 192.168.7.20:502@1")
    return place, int(device)


def _register(text: str, _: Answers) -> tuple[str, int, str, float]:
    words = text.split(":")
    if len(words) != 4 or words[0] not in CHANNELS or not words[1].isdecimal() or words[2] not in TYPES:
        raise ValueError("expected channel, address, type and scale, such as temperature_degC:0:i16:0.1")
    return words[0], int(words[1]), words[2], _positive(words[3], {})


def _canopen(answers: Answers) -> bool:
    return bool(answers["bus"] == "canopen")


def _dbc(answers: Answers) -> bool:
    return bool(answers["bus"] == "dbc")


def _has(flag: str) -> Callable[[Answers], bool]:
    return lambda answers: bool(answers.get(flag))


QUESTIONS = (
    Question("name", _name, lambda _: "axis-1"),
    Question("gear", _gear, lambda _: "CSG-20-100"),
    Question("ratio", _ratio, _ratio_of_gear),
    Question("inertia", _positive),
    Question("bus", _bus),
    Question(
        "can", _place, lambda _: "socketcan:can0",
        lambda a: _canopen(a) or _dbc(a),
    ),
    Question(
        "bitrate", lambda text, a: int(_positive(text, a)), lambda _: "500000",
        lambda a: a.get("can", ("",))[0] == "slcan",
    ),
    Question("motor-encoder", _encoder, None, _canopen),
    Question("output-encoder", _encoder, None, _canopen),
    Question(
        "servo", _servo,
        lambda _: NONE, _canopen,
    ),
    Question("dbc", _file, None, _dbc),
    Question("motor-angle", _signal, _like("in|mot|wg", "pos|ang|count"), _dbc),
    Question("motor-counts", _positive, lambda _: "131072", _has("motor-angle")),
    Question("output-angle", _signal, _like("out", "pos|ang|count"), _dbc),
    Question(
        "output-counts", _positive, lambda _: "16777216", _has("output-angle")
    ),
    Question("torque", _signal, _like("torque"), _dbc),
    Question(
        "i2c", _chip, lambda _: NONE
    ),
    Question("modbus", _device, lambda _: NONE),
    Question(
        "read", _register, None,
        _has("modbus"),
    ),
)  # fmt: skip


def init(arguments: argparse.Namespace) -> int:
    """Writes the two files, or raises `BadInput`; with `--probe` also tries them."""
    out: Path = arguments.out
    given = {row.flag: value for row in QUESTIONS if (value := getattr(arguments, row.flag.replace("-", "_")))}
    model = out.parent / f"{arguments.name or 'axis-1'}.model.toml"
    for path in (out, model):
        if path.exists() and not arguments.force:
            raise BadInput(f"{path}: is there already: expected another --out, or --force")
    answers = answered(given, out.parent, ask=_ask if not given else None)
    model = out.parent / f"{answers['name']}.model.toml"
    write_text(out, configuration(answers, model.name))
    write_text(model, model_text(answers))
    try:
        examined(out)
    except BadInput:
        out.unlink()
        model.unlink()
        raise
    print(f"{out}, {model}: written and valid")
    if not arguments.probe:
        print(f"next: edge-daemon check {out} --probe   (opens the buses, shows what they give)")
        return 0
    from edge_daemon.service.probe import tried

    return tried(out, arguments.seconds)


def answered(given: Mapping[str, str], folder: Path, ask: Callable[[str], str] | None) -> Answers:
    """All answers by flag. `ask` takes a question and gives what a person typed; without it, flags and what is usual
    must do. Raises `BadInput`."""
    answers: Answers = {"folder": folder}
    unused = set(given)
    for row in QUESTIONS:
        if not row.when(answers):
            continue
        unused.discard(row.flag)
        answers[row.flag] = _asked(row, answers, ask) if ask else _given(row, answers, given)
    if unused:
        raise BadInput(f"--{min(unused)}: has no meaning with the other answers: expected it left out")
    return answers


def _given(row: Question, answers: Answers, given: Mapping[str, str]) -> Any:
    text = given.get(row.flag) or (row.usual(answers) if row.usual else None)
    if text is None:
        raise BadInput(f"--{row.flag}: missing: expected {row.form}; `init` without flags asks for all")
    try:
        return row.read(text, answers)
    except (ValueError, BadInput) as error:
        raise BadInput(f"--{row.flag} {text}: {_plain(error)}") from error


def _asked(row: Question, answers: Answers, ask: Callable[[str], str]) -> Any:
    usual = row.usual(answers) if row.usual else None
    while True:
        text = ask(f"{row.asks} {row.form}{f' [{usual}]' if usual else ''}: ").strip() or usual
        if text is None:
            continue
        try:
            return row.read(text, answers)
        except (ValueError, BadInput) as error:
            print(f"  {text}: {_plain(error)}", file=sys.stderr)


def _ask(question: str) -> str:
    try:
        return input(question)
    except EOFError as error:
        raise BadInput(f"no answer to {question!r}: expected one, or flags (edge-daemon init --help)") from error


def _plain(error: Exception) -> str:
    text = str(error)
    return "expected a number" if text.startswith("could not convert") else text
