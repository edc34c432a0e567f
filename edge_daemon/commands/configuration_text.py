"""The text of a configuration and of a model that `init` writes: only what is used, each key with its meaning."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from edge_daemon.acquire.can_decode import dbc_layouts
from edge_daemon.acquire.i2c_presets import PRESETS
from edge_daemon.channels import CHANNELS
from edge_daemon.commands.practice import FIRST_EFFECTS, first_model
from edge_daemon.config.keys import keys
from edge_daemon.rig.can_face import DBC_FILE

COMMENT_COLUMN = 48
"""Comments begin here where the value leaves room."""
MULTI_TURN_COUNTS = 1 << 32
"""`position_value` of CiA 406 has 32 bits, and an encoder of several turns uses them all."""
SYNC_PERIOD_S = 0.001
"""The drive's own rate, so that every sample is latched."""
STAMP_WORDS = ("latch", "stamp", "time")
"""A signal beside an angle that is called so says when the angle was taken (guess)."""
SIMULATED = {
    "dbc": str(DBC_FILE),
    "motor-angle": "EncoderIn1.Position",
    "motor-counts": 131072.0,
    "output-angle": "EncoderOut1.Position",
    "output-counts": 16777216.0,
    "torque": "Drive1.Torque",
}
"""What `python -m edge_daemon.rig` sends (its drive.dbc)."""
SectionText = tuple[str, dict[str, str]]


def configuration(answers: Mapping[str, Any], model: str) -> str:
    """TOML. `answers` as `init` reads them; `model` names the model file beside it."""
    if answers["bus"] == "simulated":
        place = str((answers["folder"] / "simulated" / "can0").absolute())
        answers = {**answers, **SIMULATED, "can": ("slcan", place)}
    head = [
        "# Written by `edge-daemon init`; `edge-daemon keys` explains every key, also those that are not here.",
        "# Try it with:  edge-daemon check FILE --probe",
    ]
    if answers["bus"] == "simulated":
        head.append(f"# Its drive is simulated:  python -m edge_daemon.rig --folder {Path(place).parent}")
    told: set[str] = set()
    return "\n".join([*head, *(_written(*section, told) for section in _sections(answers, model))]) + "\n"


def model_text(answers: Mapping[str, Any]) -> str:
    """The model one begins with: a torsion balance where there are two encoders, else a drive balance."""
    two = {"theta_in_rad", "theta_out_rad"} <= {row["channel"].strip('"') for _, row in _channels(answers)}
    balance = "torsion" if two else "drive"
    return first_model(balance, answers["ratio"], answers["inertia"] if two else None, FIRST_EFFECTS[balance])


def _written(head: str, rows: Mapping[str, str], told: set[str]) -> str:
    """A section; a key is explained where it stands first, and `told` keeps which were."""
    path = head.strip("[]")
    meanings = {key.name: key.meaning for key in keys() if key.section == path}
    lines = [f"\n{head}"]
    for name, value in rows.items():
        meaning = "" if "\n" in value or f"{path}.{name}" in told else meanings.get(name, "")
        told.add(f"{path}.{name}")
        if name == "channel" and path == "drive.channels":
            meaning = CHANNELS[json.loads(value)].meaning
        lines.append(f"{f'{name} = {value}':<{COMMENT_COLUMN}}# {meaning}" if meaning else f"{name} = {value}")
    return "\n".join(lines)


def _sections(answers: Mapping[str, Any], model: str) -> Iterator[SectionText]:
    yield "[gateway]", {"site": '"site-1"', "name": f'"gateway-{answers["name"]}"'}
    if answers["bus"]:
        yield "[[can]]", _can(answers)
    if answers.get("i2c"):
        bus, part, address = answers["i2c"]
        row = f'{{ name = "housing", address = 0x{address:02x}, preset = "{part}" }}'
        yield "[[i2c]]", {"name": '"i2c"', "bus": str(bus), "devices": f"[{row}]"}
    if answers.get("modbus"):
        yield "[[modbus]]", _modbus(answers)
    rows = {"name": _text(answers["name"]), "modbus_device_id": "1", "model": _text(model)}
    if answers["gear"]:
        rows["gear"] = _text(answers["gear"])
    yield "[[drive]]", rows
    yield from _channels(answers)


def _can(answers: Mapping[str, Any]) -> dict[str, str]:
    interface, channel = answers["can"]
    rows = {"name": '"can"', "interface": _text(interface), "channel": _text(channel)}
    if "bitrate" in answers:
        rows["bitrate"] = str(answers["bitrate"])
    if answers["bus"] == "canopen":
        pdos = "\n".join(f"  {line}," for line in _pdos(answers))
        return rows | {"sync_period_s": str(SYNC_PERIOD_S), "start_nodes": "false", "pdo": f"[\n{pdos}\n]"}
    rows["dbc"] = _text(answers["dbc"])
    stamps = "\n".join(f"  {line}," for line in _stamps(answers))
    return rows | ({"stamps": f"[\n{stamps}\n]"} if stamps else {})


def _pdos(answers: Mapping[str, Any]) -> Iterator[str]:
    for key in ("motor-encoder", "output-encoder"):
        if answers[key]:
            node = answers[key][0]
            yield f'{{ node = {node}, cob_id = 0x{0x180 + node:03x}, objects = ["position_value"] }}'
    if answers["servo"]:
        node = answers["servo"][0]
        objects = '["statusword", "position_actual", "torque_actual"]'
        yield f"{{ node = {node}, cob_id = 0x{0x180 + node:03x}, objects = {objects} }}"


def _stamps(answers: Mapping[str, Any]) -> Iterator[str]:
    """For both angles or none: one alone would be of another clock."""
    angles = [answers[key] for key in ("motor-angle", "output-angle") if answers[key]]
    names = [row.name for layout in dbc_layouts(answers["folder"] / answers["dbc"]) for row in layout.fields]
    found = [_beside(angle, names) for angle in angles]
    for stamp in found if all(found) else ():
        message, _, signal = stamp.partition(".")
        yield f'{{ message = "{message}", signal = "{signal}" }}'


def _beside(angle: str, names: list[str]) -> str:
    message = angle.partition(".")[0]
    rows = [name for name in names if name.startswith(f"{message}.")]
    return next((name for name in rows if any(word in name.lower() for word in STAMP_WORDS)), "")


def _modbus(answers: Mapping[str, Any]) -> dict[str, str]:
    place, device = answers["modbus"]
    channel, address, kind, scale = answers["read"]
    host, _, port = place.rpartition(":")
    where = (
        {"transport": '"rtu"', "serial": _text(place)}
        if place.startswith("/")
        else {"transport": '"tcp"', "host": _text(host), "port": port}
    )
    read = f'{{ signal = "{channel}", address = {address}, type = "{kind}", scale = {scale:g} }}'
    return {"name": '"modbus"', **where, "device_id": str(device), "reads": f"[{read}]"}


def _channels(answers: Mapping[str, Any]) -> Iterator[SectionText]:
    if answers["bus"] == "canopen":
        yield from _canopen_channels(answers)
    elif answers["bus"]:
        values = {**answers, **(SIMULATED if answers["bus"] == "simulated" else {})}
        for channel, key in (("theta_in_rad", "motor"), ("theta_out_rad", "output")):
            if values[f"{key}-angle"]:
                counts = {"counts_per_turn": f"{values[f'{key}-counts']:.0f}"}
                yield _channel(channel, "can", values[f"{key}-angle"], counts | _wrap(values, f"{key}-angle"))
        if values["torque"]:
            yield _channel("torque_in_Nm", "can", values["torque"], {"unit": '"N m"'})
    if answers.get("i2c"):
        for signal, unit in PRESETS[answers["i2c"][1]].signals.items():
            channel = next(row.name for row in CHANNELS.values() if row.name == f"{signal}_{unit}")
            yield _channel(channel, "i2c", f"housing.{signal}", {"unit": _text(unit)})
    if answers.get("modbus"):
        channel = answers["read"][0]
        yield _channel(channel, "modbus", channel, {"unit": _text(CHANNELS[channel].unit)})


def _canopen_channels(answers: Mapping[str, Any]) -> Iterator[SectionText]:
    for channel, key in (("theta_in_rad", "motor-encoder"), ("theta_out_rad", "output-encoder")):
        if answers[key]:
            node, bits = answers[key]
            counts = {"counts_per_turn": str(1 << bits), "wrap_counts": str(max(MULTI_TURN_COUNTS, 1 << bits))}
            yield _channel(channel, "can", f"{node}:position_value", counts)
    if not answers["servo"]:
        return
    node, rated_Nm, turn = answers["servo"]
    if not answers["motor-encoder"] and turn:
        counts = {"counts_per_turn": f"{turn:.0f}", "wrap_counts": str(MULTI_TURN_COUNTS)}
        yield _channel("theta_in_rad", "can", f"{node}:position_actual", counts)
    yield _channel("torque_in_Nm", "can", f"{node}:torque_actual", {"scale": f"{rated_Nm / 1000:g}", "unit": '"N m"'})


def _wrap(answers: Mapping[str, Any], key: str) -> dict[str, str]:
    """The whole range of an integer signal: it rolls over there at the latest."""
    rows = (row for layout in dbc_layouts(answers["folder"] / answers["dbc"]) for row in layout.fields)
    row = next(row for row in rows if row.name == answers[key])
    return {} if row.is_float else {"wrap_counts": f"{2**row.bits * row.scale:.12g}"}


def _channel(channel: str, source: str, signal: str, more: dict[str, str]) -> SectionText:
    return "[[drive.channels]]", {
        "channel": _text(channel),
        "source": _text(source),
        "signal": _text(signal),
        **more,
    }


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
