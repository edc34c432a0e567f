"""Whether recordings have what a model needs, and which of their columns was probably meant for what is missing."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from edge_daemon.channels import CHANNELS
from edge_daemon.effects.expression import MOTION_NAMES, parse
from edge_daemon.effects.model import Model
from edge_daemon.errors import BadInput
from edge_daemon.recordings.column_meaning import proposed
from edge_daemon.recordings.recording import Recording
from edge_daemon.text import closest

NEEDED: dict[str, tuple[tuple[str, ...], ...]] = {
    "torsion": (("theta_in_rad",), ("theta_out_rad",)),
    "drive": (("theta_out_rad", "theta_in_rad"), ("current_in_A", "torque_in_Nm")),
}
"""Each balance wants one column of each group."""
CLOSE = 0.75
"""A name this like another is taken for a slip of the pen (guess: one letter in eight)."""
TWIST_S = 2.5e-3
"""Between samples of a twist no more time may pass: at 333 Hz what is taken for noise grows nearly fortyfold
(simulated)."""


def check_columns(balance: str, recordings: Sequence[Recording]) -> None:
    """Raises `BadInput` for the first column that is missing, with the one that was probably meant."""
    for number, recording in enumerate(recordings, start=1):
        which = f"recording {number} of {len(recordings)}: " if len(recordings) > 1 else ""
        for group in NEEDED[balance]:
            if not set(group) & set(recording.columns):
                need = f"a model of balance {balance!r} needs it"
                raise BadInput(f"{which}no column {' or '.join(group)}: {need}{_meant(group, recording.columns)}")


def coarse(balance: str, recordings: Sequence[Recording]) -> Iterator[str]:
    """A sampling that is too slow for a twist."""
    for slow in sorted({row.notes.interval_s for row in recordings}):
        if balance == "torsion" and slow > TWIST_S:
            yield (
                f"sampled at {1 / slow:.3g} Hz: a twist takes {1 / TWIST_S:g} Hz, better 1 kHz: "
                "what moves between the samples is taken for noise"
            )


def misread(model: Model, recordings: Sequence[Recording]) -> Iterator[str]:
    """Names in a formula that are numbers to be fitted, but look like a channel."""
    channels = sorted({*MOTION_NAMES, *(name for recording in recordings for name in recording.columns)})
    for effect in model.effects:
        for name in parse(effect.expression, channels).parameters if effect.expression else ():
            begun = [channel for channel in channels if channel.startswith(f"{name}_") and len(name) > len("theta")]
            close = begun[0] if begun else closest(name, channels, CLOSE)
            if close:
                yield f"{effect.name}: {name!r} is taken for a number to be fitted: is the channel {close!r} meant?"


def _meant(group: Sequence[str], there: Collection[str]) -> str:
    own = [name for name in there if name not in CHANNELS]
    proposal = proposed(own, group)
    if proposal:
        return f": did you mean {proposal}?"
    for wanted in group:
        stem = wanted.rpartition("_")[0]
        counted = next((name for name in own if name.rpartition("_")[0] == stem), "")
        if counted:
            return f": {counted!r} must be converted, and called {wanted}"
    if group == ("theta_in_rad",) and "theta_out_rad" in there:
        return ": with one encoder only, the model's balance is 'drive'"
    if group == ("theta_out_rad",) and "theta_in_rad" in there:
        return ": if a stand holds the output: --map theta_out_rad=0"
    if "torque_in_Nm" in group and "torque_out_Nm" in there:
        return ": if torque_out_Nm is the motor's, as seen at the output: --map torque_in_Nm=torque_out_Nm/RATIO"
    return f": expected it beside {', '.join(list(there)[:8])}"
