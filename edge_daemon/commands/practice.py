"""Commands to practise with, and the catalogue: simulate, reveal, effects and noise. No daemon, no bus."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edge_daemon.errors import BadInput
from edge_daemon.text import number, table, write_json, write_text, written_as_json

TONES_SHOWN = 10
SHORTEST_S, LONGEST_S = 0.1, 600.0
"""A simulated recording is at least and at most this long; the longest takes 2 GB: all of it is in memory, at eight
times its rate."""
LARGEST_SEED = 2**63 - 1
MOST_BITS = 32
"""No encoder that is sold is finer; 0 bits are a perfect one."""


def effects(arguments: argparse.Namespace) -> None:
    """The catalogue, as text or JSON."""
    from edge_daemon.effects.catalogue import CATALOGUE

    if arguments.json:
        rows = [
            {
                "name": row.name,
                "balance": row.balance,
                "kind": row.kind,
                "meaning": row.meaning,
                "equation": row.equation,
                "source": row.source,
                "parameters": [
                    {"kind": kind, **dataclasses.asdict(parameter)}
                    for kind, parameters in (("amplitude", row.amplitudes), ("shape", row.shapes))
                    for parameter in parameters
                ],
            }
            for row in CATALOGUE.values()
        ]
        write_json({"effects": rows}, "-")
        return
    for balance in ("torsion", "drive"):
        chosen = [row for row in CATALOGUE.values() if row.balance == balance]
        print(f"{balance} balance")
        print(table(("effect", "meaning", "equation"), [(row.name, row.meaning, row.equation) for row in chosen]), "\n")


FIRST_EFFECTS = {"torsion": ("linear_stiffness", "viscous_damping"), "drive": ("inertia",)}
"""Every gear has these, so a model of its balance begins with them."""


def simulate(arguments: argparse.Namespace) -> None:
    """A recording, and on request the model that one would begin with."""
    from edge_daemon.rig import recording, secret

    if not SHORTEST_S <= arguments.seconds <= LONGEST_S:
        raise BadInput(f"--seconds {arguments.seconds}: expected {SHORTEST_S:g} to {LONGEST_S:g}")
    for name, most in (("seed", LARGEST_SEED), ("hidden", LARGEST_SEED), ("bits", MOST_BITS)):
        value = getattr(arguments, name)
        if value is not None and not 0 <= value <= most:
            raise BadInput(f"--{name} {value}: expected 0 to {most}")
    if arguments.hidden is not None and arguments.effect:
        raise BadInput("--hidden draws the effect itself: expected no --effect beside it")
    try:
        if arguments.hidden is not None:
            made = recording.hidden(arguments.hidden, arguments.seconds, arguments.bits)
        else:
            made = recording.simulate(
                arguments.effect,
                seconds=arguments.seconds,
                seed=arguments.seed,
                bits_out=arguments.bits,
                motion=arguments.motion,
                balance=arguments.balance,
            )
        secret.write(made, arguments.out)
    except recording.UnknownEffect as error:
        raise BadInput(str(error)) from error
    except OSError as error:
        raise BadInput(f"{arguments.out}: cannot write: {error.strerror}") from error
    what = f"{len(made.time_s)} samples of {', '.join(made.columns)}"
    if arguments.hidden is not None:
        print(f"{arguments.out}: {what}; its effect is sealed in {secret.seal(arguments.out, made.truth)}")
    else:
        print(f"{arguments.out}: {what}; effects: {', '.join(arguments.effect) or 'none beyond a plain gear'}")
    if arguments.model:
        _write_first_model(arguments.model, made.truth)
        print(f"{arguments.model}: the model one would begin with")
        print(f"next: edge-daemon compare {arguments.out} --model {arguments.model}")


def _write_first_model(path: Path, truth: Mapping[str, Any]) -> None:
    parameters = truth["parameters"]
    names = FIRST_EFFECTS[truth["balance"]]
    inertia = None if truth["balance"] == "drive" else parameters["inertia_kg_m2"]
    write_text(path, first_model(truth["balance"], parameters.get("ratio", 100.0), inertia, names))


def first_model(balance: str, ratio: float, output_inertia_kg_m2: float | None, effects: Sequence[str]) -> str:
    """The model file that one would begin with: what the maker and the drawing say."""
    lines = ["[joint]", f'balance = "{balance}"', f"ratio = {ratio}"]
    if output_inertia_kg_m2 is not None:
        lines.append(f"output_inertia_kg_m2 = {output_inertia_kg_m2!r}")
    lines += [f'\n[[effect]]\nname = "{name}"' for name in effects]
    return "\n".join(lines) + "\n"


def reveal(arguments: argparse.Namespace) -> None:
    """Names what `simulate --hidden` hid."""
    from edge_daemon.rig import secret

    try:
        truth = secret.reveal(arguments.recording)
    except secret.SealError as error:
        raise BadInput(str(error)) from error
    hidden, parameters = truth["effects"], truth["parameters"]
    assert isinstance(hidden, list) and isinstance(parameters, dict)
    print(f"hidden: {' + '.join(hidden) or 'nothing: a plain gear'}")
    print(table(("parameter", "value"), [(name, number(value, 6)) for name, value in parameters.items()]))


def noise(arguments: argparse.Namespace) -> None:
    """The noise model of a sound."""
    from edge_daemon.sound.noise_model import noise_json
    from edge_daemon.sound.sound_file import fit_sound_file

    fit, unit, notes = fit_sound_file(arguments.sound)
    for line in notes:
        print(f"{arguments.sound}: {line}", file=sys.stderr)
    document = noise_json(fit, unit)
    if written_as_json(document, arguments.json):
        return
    rows = [
        (f"a{row['beta']}", number(row["value"]), number(row["sd"], 2), "yes" if row["identified"] else "no")
        for row in _rows(document, "coefficients")
    ]
    print(f"S(f) = sum of a_b (f / {fit.reference_hz:g} Hz)^-b [{unit}], {number(fit.averages, 3)} averages")
    print(table(("coefficient", "value", "sd", "identified"), rows))
    tones = [f"{row['frequency_hz']:.1f} Hz" for row in _rows(document, "tones")]
    more = f" and {len(tones) - TONES_SHOWN} weaker ones" if len(tones) > TONES_SHOWN else ""
    print(f"tones left out of the fit: {', '.join(tones[:TONES_SHOWN]) or 'none'}{more}")
    lost = [row[0] for row in rows if row[3] == "no"]
    if lost:
        print(f"{', '.join(lost)}: not identified by this record: average longer, or widen the band")
        wanted = [(b, it) for b, it in enumerate(fit.averages_needed) if it > fit.averages]
        needed = [f"a{b} {float(f'{it:.2g}'):.0f}" for b, it in wanted]
        print(f"averages needed, if they are as large as they seem: {', '.join(needed)}")


def _rows(document: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    return list(document[key])
