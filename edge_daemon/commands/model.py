"""What is done with a model: fit, compare, diagnose, add, remove and undo. On files, never in the daemon."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TextIO

from edge_daemon.commands.recordings import columns_told, named_columns
from edge_daemon.discover.discover import discover as discovered
from edge_daemon.discover.table import table_over
from edge_daemon.effects.model import Model
from edge_daemon.effects.model_file import read_model
from edge_daemon.effects.model_undo import rewrite
from edge_daemon.effects.model_undo import undo as take_back
from edge_daemon.effects.torque_source import torque_source
from edge_daemon.errors import BadInput
from edge_daemon.explain import add as adding
from edge_daemon.explain.compare import compare as compared
from edge_daemon.explain.interpretation import PARAMETER_HEAD, adequate, is_guess, parameter_cells, times_noise
from edge_daemon.explain.results import Candidate, Comparison, Diagnosis, Error, ParameterLine, Proposal, none_of
from edge_daemon.recordings.recording import Recording, read_recording
from edge_daemon.service.column_check import check_columns, coarse, misread
from edge_daemon.service.subsample import left_out, shortened
from edge_daemon.stiffness.stations import STIFFNESS_FORMS, stiffness_form
from edge_daemon.text import number, progress, table, with_sd, write_text, written_as_json

WHERE_SHOWN = 6
NOWHERE = "follows no channel of this recording"
CANDIDATES_SHOWN = 5
PROPOSALS_SHOWN = 3
NEAR = 2.0
"""Up to this error over noise nothing need be missing (what was right left up to 1.5)."""
BLIND = 0.3
"""From this noise over torque on a model that is as good as the sensors need not be good (guess)."""
ROUNDS_TO_NOTHING = 5e-3
"""A smaller probability is shown as nothing."""
SHOWN = 5e-4
"""A change below this share of the error rounds to nothing in print."""


def fit(arguments: argparse.Namespace) -> None:
    """Fits the model's parameters and writes them into its file."""
    recordings, model = _read(arguments)
    result = compared(recordings, model)
    rewrite(arguments.model, result.model, f"fit {_recorded_names(arguments)}")
    if _as_json(arguments, result):
        return
    _warn(result.warnings)
    print(_error(result.error))
    print(_parameters(result.parameters))
    print(f"{arguments.model}: parameters written")


def compare(arguments: argparse.Namespace) -> None:
    """How wrong the model is, and where."""
    recordings, model = _read(arguments)
    result = compared(recordings, model)
    if arguments.report:
        from edge_daemon.service.model_report import of_comparison

        write_text(arguments.report, of_comparison(result, _title(arguments)))
    if _as_json(arguments, result):
        return
    _warn(result.warnings)
    print(_error(result.error))
    print(f"\nwhere the error is:\n{_where(result)}" if result.where else f"\nthe error {NOWHERE}")
    print(f"\n{_parameters(result.parameters)}")
    names = " ".join(map(str, arguments.recording))
    if not adequate(result.error):
        near = result.error.nrmse < NEAR * result.error.noise_floor_nrmse
        doubt = "near the sensors' noise; whether anything is left to name is what the diagnosis says\n" if near else ""
        print(f"\n{doubt}next: edge-daemon diagnose {names} --model {arguments.model}")
    else:
        print(f"\nthe model is as good as the sensors can tell{_blind(result.error)}")


def diagnose(arguments: argparse.Namespace) -> None:
    """Which physical effect is missing, and which law where the catalogue has none."""
    _diagnose(arguments, thorough=False)


def discover(arguments: argparse.Namespace) -> None:
    """Laws outside the catalogue: formulas for what its effects leave."""
    _diagnose(arguments, thorough=True)


def _diagnose(arguments: argparse.Namespace, thorough: bool) -> None:
    recordings, model = _read(arguments)
    result = discovered(recordings, model, progress("discover" if thorough else "diagnose"), thorough)
    if arguments.report:
        from edge_daemon.service.model_report import of_diagnosis

        write_text(arguments.report, of_diagnosis(result, compared(recordings, model), _title(arguments)))
    if _as_json(arguments, result):
        return
    _warn(result.warnings)
    print(_verdict(result))
    if result.candidates:
        print(_candidates(result.candidates))
    if result.verdict == "unexplained":
        axes = ", ".join(f"{row.axis} ({row.share:.0%})" for row in result.where[:3])
        print(f"the missing effect depends on: {axes}" if axes else f"the error {NOWHERE}")
    if result.next_experiment:
        plan = result.next_experiment
        print(f"next experiment, to tell {' from '.join(plan.separates)}: {plan.motion}")
    print(_proposed(result, thorough), end="")
    for line in next_steps(result, arguments, model):
        print(line)


def next_steps(result: Diagnosis, arguments: argparse.Namespace, model: Model) -> list[str]:
    """What to do now, the more probable first: a cause, or some formula, whichever of those that were proposed."""
    onto = f"--model {arguments.model} --recording {' '.join(map(str, arguments.recording))}"
    law = [f'next: edge-daemon add NAME --expression "{row.expression}" {onto}' for row in result.proposals[:1]]
    believed = result.candidates[0].probability if result.candidates else 0.0
    formula = sum(row.probability for row in result.proposals)
    named = result.verdict == "missing" and believed >= none_of(result.candidates)
    cause = [f"next: edge-daemon add {result.candidates[0].effect} {onto}"] if named or believed > formula > 0.0 else []
    if cause or law or result.verdict == "adequate" or result.next_experiment:
        return [*law, *cause] if formula > believed else [*cause, *law]
    if result.candidates:
        return ["next: record another motion: as it is, none of them is more probable than any"]
    if model.balance == "drive" and not model.effect("model_torque"):
        return [
            "next: did other joints move? record what the controller computes for this one (torque_model_Nm), or move "
            "it alone"
        ]
    return ['next: try a formula of your own: edge-daemon add NAME --expression "..." --model M --recording REC']


def add(arguments: argparse.Namespace) -> int:
    """Adds an effect to the model, refits, and shows the error before and after; 1 where it does not help."""
    if arguments.table and (arguments.expression or not arguments.recording):
        raise BadInput("--table: expected --recording, which says where the table's places are, and no --expression")
    formed = arguments.effect in STIFFNESS_FORMS and not arguments.expression
    if formed and not arguments.recording:
        raise BadInput(f"{arguments.effect}: expected --recording, which says where its stations are")
    if not arguments.recording:
        larger = adding.with_added(read_model(arguments.model), arguments.effect, arguments.expression)
        return _unfitted(arguments, larger, "added")
    recordings, model = _read(arguments, graded=False)
    expression = table_over(recordings, model, arguments.table) if arguments.table else arguments.expression
    if formed and not arguments.table:
        expression = stiffness_form(recordings, model, arguments.effect)
    done = adding.add_effect(model, arguments.effect, recordings, _recorded_names(arguments), expression)
    wanted = done.helps or arguments.force
    if wanted:
        rewrite(arguments.model, done.model, f"add {arguments.effect}")
    notes = [*misread(done.model, recordings)]
    if not _as_json(arguments, done, {"written": wanted}, notes):
        _warn([*notes, *done.warnings])
        print(_changed(done))
        print(_fate(arguments, wanted))
    if arguments.report:
        from edge_daemon.service.model_report import of_comparison

        write_text(arguments.report, of_comparison(compared(recordings, done.model), _title(arguments)))
    return 0 if wanted else 1


def remove(arguments: argparse.Namespace) -> int:
    """Takes an effect out of the model, refits, and shows the error before and after."""
    if not arguments.recording:
        return _unfitted(arguments, adding.without(read_model(arguments.model), arguments.effect), "removed")
    recordings, model = _read(arguments, graded=False)
    done = adding.remove_effect(model, arguments.effect, recordings, _recorded_names(arguments))
    rewrite(arguments.model, done.model, f"remove {arguments.effect}")
    if not _as_json(arguments, done, {"written": True}):
        _warn(done.warnings)
        print(_changed(done))
        print(_fate(arguments, True))
    return 0


def undo(arguments: argparse.Namespace) -> None:
    """Gives the model file the text that it had before the last command that changed it."""
    read_model(arguments.model)
    change = take_back(arguments.model, arguments.force)
    if not written_as_json({"undone": change, "model": str(arguments.model)}, arguments.json):
        print(f"{arguments.model}: as before {change!r}; a daemon that runs it takes it over")


# reading and writing


def _unfitted(arguments: argparse.Namespace, model: Model, what: str) -> int:
    """Writes a model whose effects were changed without a recording to fit them to."""
    rewrite(arguments.model, model, f"{what} {arguments.effect}")
    document = {"effect": arguments.effect, "written": True, "effects": [row.name for row in model.effects]}
    if not written_as_json(document, arguments.json):
        print(f"{arguments.model}: {arguments.effect} {what}; next: edge-daemon fit REC --model {arguments.model}")
    return 0


def _read(arguments: argparse.Namespace, graded: bool = True) -> tuple[list[Recording], Model]:
    """The recordings and the model, with what is to be said of them; `graded`: how coarse the encoders are too."""
    model = read_model(arguments.model)
    recordings, notes = _recordings(arguments)
    _check(arguments.model, model, recordings)
    if graded:
        notes += [*coarse(model.balance, recordings), *misread(model, recordings)]
    _warn(notes, sys.stderr if arguments.json == "-" else sys.stdout)
    return recordings, model


def _check(path: Path, model: Model, recordings: Sequence[Recording]) -> None:
    """What the recordings need of the model, said with the name of its file."""
    if not model.effects:
        raise BadInput(f"{path}: effect: missing: expected at least one [[effect]]")
    check_columns(model.balance, recordings)
    known = all(torque_source(row.columns, model.output_inertia_kg_m2) for row in recordings)
    if model.balance == "torsion" and not known:
        raise BadInput(f"{path}: joint.output_inertia_kg_m2: missing: needed without torque_out_Nm or torque_in_Nm")


def _recordings(arguments: argparse.Namespace) -> tuple[list[Recording], list[str]]:
    """As much of the recordings as can be worked on, and what is to be said of them."""
    paths = arguments.recording
    named = [named_columns(path, arguments) for path in paths]
    whole = [read_recording(path, columns=columns) for path, columns in zip(paths, named, strict=True)]
    used = shortened(whole)
    rows = zip(paths, named, whole, strict=True)
    told = [(path, (*columns_told(path, columns), *row.notes.lines())) for path, columns, row in rows]
    notes = [f"{path}: {line}" for path, lines in told for line in lines]
    return used, [*notes, *left_out(paths, whole, used)]


def _as_json(
    arguments: argparse.Namespace,
    result: Comparison | Diagnosis | adding.StructureChange,
    more: Mapping[str, object] | None = None,
    notes: Sequence[str] = (),
) -> bool:
    """Writes the JSON where it is asked for; True where standard output is now its own, and warnings went elsewhere."""
    if not written_as_json({**result.to_json(), **(more or {})}, arguments.json):
        return False
    _warn([*notes, *result.warnings], sys.stderr)
    return True


def _recorded_names(arguments: argparse.Namespace) -> str:
    return " ".join(path.name for path in arguments.recording)


def _title(arguments: argparse.Namespace) -> str:
    return f"{arguments.model.name} against {_recorded_names(arguments)}"


# printing


def _warn(lines: Sequence[str], where: TextIO | None = None) -> None:
    for line in lines:
        print(f"warning: {line}", file=where)


def _percent(error: Error) -> str:
    return f"{error.nrmse:.2%} ({error.rmse:.3g} {error.unit})"


def _error(error: Error) -> str:
    noise = f"sensor noise alone: {error.noise_floor_nrmse:.2%}; {number(times_noise(error), 3)} times that"
    return f"held-out error: {_percent(error)}; {noise}"


def _blind(error: Error) -> str:
    """What to add to a good verdict where there was little to judge by."""
    if error.noise_floor_nrmse < BLIND:
        return ""
    return f", which is little: their noise is {error.noise_floor_nrmse:.0%} of it: more torque, or a finer encoder"


def _fate(arguments: argparse.Namespace, wanted: bool) -> str:
    """What became of the model file."""
    if wanted:
        return f"{arguments.model}: written; a daemon that runs it takes it over"
    return (
        f"{arguments.model}: left as it was: this effect does not help on this recording; record other motion, "
        "or write it all the same with --force"
    )


def _changed(done: adding.StructureChange) -> str:
    fell = 1.0 - done.after.nrmse / done.before.nrmse if done.before.nrmse else 0.0
    gain = "as before" if abs(fell) < SHOWN else f"{fell:.1%} less" if fell > 0 else f"{-fell:.1%} more"
    lines = [
        f"{done.name}: held-out error {_percent(done.before)} -> {_percent(done.after)}: {gain}",
        f"sensor noise alone would leave {done.after.noise_floor_nrmse:.2%}",
    ]
    lines.append(table(("effect", "parameter", "before", "after", "unit"), [*_moved(done), *_new(done)]))
    if len(done.model.lineage) > 1:
        lines.append(table(("version", "held-out error"), [(v.change, f"{v.nrmse:.2%}") for v in done.model.lineage]))
    return "\n".join(lines)


def _moved(done: adding.StructureChange) -> list[tuple[str, ...]]:
    """What the change made of the other numbers."""
    return [(row.effect, row.name, number(row.before.value), _after(row), row.after.unit) for row in done.moved]


def _after(row: adding.Moved) -> str:
    """A number with its sd, and whether the recording still determines it, where it did before."""
    return with_sd(row.after.value, row.after.sd) + (" (no longer identified)" if row.lost else "")


def _new(done: adding.StructureChange) -> list[tuple[str, ...]]:
    """What it brought: of a formula these are all names that are no channels."""
    effects = [effect for effect in done.model.effects if effect.name in done.name.split("+")]
    return [
        (effect.name, name, "-", with_sd(row.value, row.sd), row.unit)
        for effect in effects
        for name, row in effect.parameters.items()
    ]


def _where(result: Comparison) -> str:
    rows = [(row.axis, f"{row.share:.0%}", row.detail) for row in result.where[:WHERE_SHOWN]]
    return table(("axis", "share of it", "detail"), rows)


def _parameters(rows: Sequence[ParameterLine]) -> str:
    return table(PARAMETER_HEAD, parameter_cells(rows))


def _verdict(result: Diagnosis) -> str:
    meaning = {
        "adequate": "nothing is left that an effect would explain",
        "missing": "an effect is missing, and it can be named",
        "unexplained": "structure is left that no effect of the catalogue removes",
    }
    if result.verdict == "missing" and is_guess(result.candidates[0]):
        meaning["missing"] = "an effect is missing, but which is no more than a guess"
    meaning["adequate"] += _blind(result.error)
    return f"{result.verdict}: {meaning[result.verdict]}\n{_error(result.error)}"


def _proposed(result: Diagnosis, thorough: bool) -> str:
    """The formulas, each with what it reads like and where it was seen; a line where there is none."""
    if not result.proposals:
        none = "no formula is proposed: " + (
            "nothing is left that one would explain"
            if result.verdict == "adequate"
            else "none does better than the catalogue"
            if result.verdict == "missing"
            else "no short one explains what is left"
        )
        return f"{none}\n" if thorough or result.verdict == "unexplained" else ""
    return "formulas for what is left:\n" + "".join(_proposal(row) for row in result.proposals[:PROPOSALS_SHOWN])


def _proposal(row: Proposal) -> str:
    seen = ", ".join(f"{axis} {number(low)} to {number(high)}" for axis, (low, high) in row.range.items())
    like = f"; of the catalogue nearest to {row.resembles}" if row.resembles else ""
    return (
        f"  {row.expression}\n"
        f"    error after {row.nrmse_after:.2%}, probability {row.probability:.2f}: {row.reads}\n"
        f"    seen over {seen}{like}\n"
    )


def _candidates(rows: Sequence[Candidate]) -> str:
    cells = [
        (
            row.effect,
            f"{row.nrmse_before:.2%}",
            f"{row.nrmse_after:.2%}",
            f"{row.probability:.2f}",
            ", ".join(row.confused_with) or "-",
        )
        for row in rows[:CANDIDATES_SHOWN]
    ]
    none = none_of(rows)
    if none > ROUNDS_TO_NOTHING:
        cells.append(("none of them", "", "", f"{none:.2f}", ""))
    return table(("candidate", "error before", "after", "probability", "cannot be told from"), cells)
