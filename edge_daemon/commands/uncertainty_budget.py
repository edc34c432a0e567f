"""What an installation can see before anything is measured: noise, floors, smallest change, and what to mend.

The twist noise has three white parts, all seen from the output: the steps of both encoders (a step's error is uniform,
variance 1/12; Widrow and Kollar 2008, "Quantization Noise"), noise of the encoders beyond their steps, and the
jitter of the instants at which they latch, which speed turns into angle. A constant skew between the encoders is no
noise but a disguise: K * skew [N m s/rad] of friction on the output that is not there.

The figures hold well below the resonance sqrt(K / J); near it they are pessimistic, since the same encoder error then
stands on both sides of the balance and partly cancels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist

from edge_daemon.channels import CHANNELS
from edge_daemon.config.settings import CanSource, ChannelSettings, Drive, Settings
from edge_daemon.effects.catalogue import of_balance
from edge_daemon.effects.effect import Effect, Told
from edge_daemon.encoders.ratio import TIMING_SHARE

NAMING_RATIO = 70.0
"""An effect can be named from this rms of the twist over its noise (measured: greedy held-out search, 14 effects)."""
WRONG_RATIO = 10.0
"""Below this only 'something is wrong' can be said (measured likewise)."""
CONFIDENCE = 0.99
"""A loss is noticed, and no alarm raised without one, with this probability per look."""
RECORD_S = 60.0
"""The uncertainty of the stiffness is stated for a record of this length."""
HOUR_S = 3600.0
LATCH_JITTER_S = 1e-6
"""Encoders latched by one SYNC frame have the spread of interrupt entry (guess; a wire does better)."""
HOST_JITTER_S = 1e-4
"""Frames stamped when the gateway receives them have bus arbitration and kernel wake-up in them (guess)."""
STEP_VARIANCE = 1 / 12
ARC_MINUTE_RMS_RAD = math.pi / 10_800 / math.sqrt(8)
"""RMS of a sine of one arc minute from peak to peak, the makers' figure of the kinematic error."""
ENOUGH_BITS = 32


@dataclass(frozen=True, slots=True)
class Timing:
    """How well the two encoders are read at one instant."""

    latched: bool
    """both take their value at one instant: SYNC, stamps of one clock, or a wire"""
    jitter_s: float
    """sd of the difference between the two instants, from sample to sample"""
    skew_s: float
    """largest constant difference to be expected"""


@dataclass(frozen=True, slots=True)
class Installation:
    """The figures of one drive and its sensors. SI units."""

    counts_in: float
    """steps per turn of the motor encoder"""
    counts_out: float
    """steps per turn of the output encoder"""
    rate_hz: float
    cutoff_hz: float
    inertia_kg_m2: float
    ratio: float
    stiffness_Nm_per_rad: float
    timing: Timing
    noise_in_rad: float = 0.0
    """sd of the encoder beyond its steps, motor side"""
    noise_out_rad: float = 0.0
    corner_1_Nm: float | None = None
    """the maker's T1: above it the gear is stiffer"""
    corner_2_Nm: float | None = None
    measured: frozenset[str] = frozenset(("theta_in_rad", "theta_out_rad"))
    """Channels that there are."""
    baseline_s: float = HOUR_S
    """how much operation the baseline of the stiffness was learned from"""


@dataclass(frozen=True, slots=True)
class Operation:
    """The motion to be expected, as a sine of the output."""

    frequency_hz: float
    speed_out_rad_s: float
    """peak"""
    duty: float = 1.0
    """share of the time in motion"""


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """One figure and what it means."""

    name: str
    value: float
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class UncertaintyBudget:
    """What this installation can see."""

    rows: tuple[BudgetRow, ...]
    named: tuple[str, ...]
    """effects that a diagnosis may name here"""
    refused: tuple[tuple[str, str], ...]
    """(effects, why they cannot be named)"""
    advice: str
    """what to change first"""

    def figure(self, name: str) -> float:
        """The value of the row of that name. Raises KeyError."""
        return {row.name: row.value for row in self.rows}[name]


def timing_of(settings: Settings, drive: Drive) -> Timing:
    """What the configuration promises about the two encoders' instants; the figures are stated guesses."""
    channels = {row.channel: row for row in drive.channels}
    inner, outer = channels.get("theta_in_rad"), channels.get("theta_out_rad")
    if inner is None or outer is None:
        return Timing(False, HOST_JITTER_S, 0.0)
    if inner.source == outer.source and _latched(settings, inner, outer):
        return Timing(True, LATCH_JITTER_S, 0.0)
    return Timing(False, HOST_JITTER_S, 0.5 / drive.rate_hz)


def _latched(settings: Settings, inner: ChannelSettings, outer: ChannelSettings) -> bool:
    if any(row.name == inner.source for row in settings.file):
        return True  # one recording, one time column
    can = next((row for row in settings.can if row.name == inner.source), None)
    if can is None:
        return False
    return can.sync_period_s is not None or _one_message(inner, outer) or _one_clock(can, inner, outer)


def _one_message(inner: ChannelSettings, outer: ChannelSettings) -> bool:
    names = [row.signal.rpartition(".")[0] for row in (inner, outer)]
    return names[0] == names[1] != ""


def _one_clock(can: CanSource, inner: ChannelSettings, outer: ChannelSettings) -> bool:
    clocks = {stamp.message: stamp.clock for stamp in can.stamps}
    found = [clocks.get(row.signal.rpartition(".")[0]) for row in (inner, outer)]
    return found[0] is not None and found[0] == found[1]


def installation_of(
    settings: Settings,
    drive: Drive,
    *,
    ratio: float,
    inertia_kg_m2: float,
    stiffness_Nm_per_rad: float,
    corners_Nm: tuple[float | None, float | None] = (None, None),
) -> Installation | None:
    """The drive's figures, from its configuration, its model and its gear; None without two encoders' step counts."""
    counts = {row.channel: row.counts_per_turn for row in drive.channels}
    inner, outer = counts.get("theta_in_rad"), counts.get("theta_out_rad")
    if inner is None or outer is None:
        return None
    estimation = drive.estimation
    return Installation(
        counts_in=inner,
        counts_out=outer,
        rate_hz=drive.rate_hz,
        cutoff_hz=estimation.cutoff_hz,
        inertia_kg_m2=inertia_kg_m2,
        ratio=ratio,
        stiffness_Nm_per_rad=stiffness_Nm_per_rad,
        timing=timing_of(settings, drive),
        noise_in_rad=estimation.encoder_noise_in_rad,
        noise_out_rad=estimation.encoder_noise_out_rad,
        corner_1_Nm=corners_Nm[0],
        corner_2_Nm=corners_Nm[1],
        measured=frozenset(counts),
        baseline_s=estimation.baseline_after_s,
    )


def twist_noise_rad(it: Installation, speed_rms_rad_s: float = 0.0) -> float:
    """sd [rad] of one twist sample: both encoders' steps and noise, and jitter at this output speed."""
    step_in, step_out = 2 * math.pi / it.counts_in, 2 * math.pi / it.counts_out
    inner = (STEP_VARIANCE * step_in**2 + it.noise_in_rad**2) / it.ratio**2
    outer = STEP_VARIANCE * step_out**2 + it.noise_out_rad**2
    return math.sqrt(inner + outer + (speed_rms_rad_s * it.timing.jitter_s) ** 2)


def in_band(it: Installation) -> float:
    """Share of a white noise's sd that the balance's filter lets through."""
    return math.sqrt(min(1.0, 2 * it.cutoff_hz / it.rate_hz))


def smallest_loss(sd_relative: float, motion_s: float, baseline_s: float) -> float:
    """Relative stiffness loss noticed with `CONFIDENCE` from `motion_s` of motion against the baseline.

    One-sided, the same error probability either way; random error only. `sd_relative` is sd(k)/k after `motion_s`.
    """
    z = NormalDist().inv_cdf(CONFIDENCE)
    return 2 * z * sd_relative * math.sqrt(1 + motion_s / baseline_s)


@dataclass(frozen=True, slots=True)
class _Figures:
    """The numbers behind the rows."""

    torque_peak_Nm: float
    phi_rms_rad: float
    noise_rad: float
    """one sample"""
    noise_band_rad: float
    sd_minute: float
    loss_hour: float
    skew_rad: float

    @property
    def sight(self) -> float:
        return self.phi_rms_rad / self.noise_band_rad

    @property
    def timing_carries(self) -> bool:
        return self.skew_rad <= TIMING_SHARE * self.phi_rms_rad


def _figures(it: Installation, op: Operation, measured_noise_rad: float | None) -> _Figures:
    passed = 1.0 if op.frequency_hz <= it.cutoff_hz else 0.0
    torque = it.inertia_kg_m2 * 2 * math.pi * op.frequency_hz * op.speed_out_rad_s
    phi_rms = passed * torque / it.stiffness_Nm_per_rad / math.sqrt(2)
    speed_rms = op.speed_out_rad_s / math.sqrt(2)
    noise = twist_noise_rad(it, speed_rms) if measured_noise_rad is None else measured_noise_rad
    # jitter is largest where the sine's twist is zero: only half its variance reaches the stiffness
    reaches = twist_noise_rad(it, speed_rms / math.sqrt(2)) if measured_noise_rad is None else noise
    per_root_s = reaches / math.sqrt(it.rate_hz * op.duty) / phi_rms if phi_rms else math.inf
    loss = smallest_loss(per_root_s / math.sqrt(HOUR_S), HOUR_S * op.duty, it.baseline_s)
    return _Figures(
        torque_peak_Nm=torque,
        phi_rms_rad=phi_rms,
        noise_rad=noise,
        noise_band_rad=noise * in_band(it),
        sd_minute=per_root_s / math.sqrt(RECORD_S),
        loss_hour=loss,
        skew_rad=abs(it.timing.skew_s) * speed_rms,
    )


def budget(it: Installation, op: Operation, measured_noise_rad: float | None = None) -> UncertaintyBudget:
    """What this installation can see in this motion. `measured_noise_rad`: sd of one twist sample, live instead of
    computed."""
    figures = _figures(it, op, measured_noise_rad)
    named, refused = _nameable(it, figures)
    return UncertaintyBudget(_rows(it, op, figures), named, refused, _advice(it, op, figures))


def _rows(it: Installation, op: Operation, f: _Figures) -> tuple[BudgetRow, ...]:
    k = it.stiffness_Nm_per_rad
    jitter_rad = op.speed_out_rad_s / math.sqrt(2) * it.timing.jitter_s
    return (
        BudgetRow("torque_peak", f.torque_peak_Nm, "N m", f"inertia torque of this motion{_against_corners(it, f)}"),
        BudgetRow("twist_rms", f.phi_rms_rad, "rad", "what the motion twists the gear by"),
        BudgetRow("twist_noise", f.noise_rad, "rad", "one sample: encoder steps, encoder noise, jitter"),
        BudgetRow("twist_noise_in_band", f.noise_band_rad, "rad", f"what passes the {it.cutoff_hz:g} Hz filter"),
        BudgetRow("twist_over_noise", f.sight, "1", _sight(f.sight)),
        BudgetRow("torque_floor", k * f.noise_band_rad, "N m", "a smaller torque drowns in encoder noise"),
        BudgetRow("stiffness_sd", f.sd_minute, "1", f"sd(k)/k from {RECORD_S:g} s of operation"),
        BudgetRow(
            "smallest_loss",
            f.loss_hour,
            "1",
            f"stiffness loss one hour shows, {CONFIDENCE:.0%} sure; random error only",
        ),
        BudgetRow(
            "jitter_twist", jitter_rad, "rad", f"{it.timing.jitter_s * 1e6:.3g} us of latch jitter at this speed"
        ),
        BudgetRow("skew_twist", f.skew_rad, "rad", f"{abs(it.timing.skew_s) * 1e6:.3g} us of skew: {_skew_verdict(f)}"),
        BudgetRow("skew_friction", k * abs(it.timing.skew_s), "N m s/rad", "output friction that this skew imitates"),
    )


def _against_corners(it: Installation, f: _Figures) -> str:
    if it.corner_1_Nm is None:
        return ""
    return (
        f"; the gear's T1 is {it.corner_1_Nm:g} N m, so {'beyond' if f.torque_peak_Nm > it.corner_1_Nm else 'below'} it"
    )


def _sight(ratio: float) -> str:
    if ratio >= NAMING_RATIO:
        return f"effects can be named (from {NAMING_RATIO:g})"
    if ratio >= WRONG_RATIO:
        return f"stiffness and large effects only; naming wants {NAMING_RATIO:g}"
    return "only that something is wrong can be said"


def _skew_verdict(f: _Figures) -> str:
    if f.skew_rad == 0:
        return "none expected"
    share = f.skew_rad / f.phi_rms_rad if f.phi_rms_rad else math.inf
    return f"{share:.2g} of the twist{'' if f.timing_carries else '; torque effects must not be named from it'}"


def _nameable(it: Installation, f: _Figures) -> tuple[tuple[str, ...], tuple[tuple[str, str], ...]]:
    """Effects that may be named, and those that may not with the reason, each reason once."""
    told = _told(it, f)
    rows = [(row.name, _why_not(row, it, told)) for row in of_balance("torsion")]
    refused = {why: ", ".join(name for name, other in rows if other == why) for _, why in rows if why}
    return tuple(name for name, why in rows if not why), tuple((names, why) for why, names in refused.items())


def _why_not(effect: Effect, it: Installation, told: Mapping[Told, str]) -> str:
    """Why an effect cannot be named here; empty where it can."""
    lacking = [need for need in effect.needs if need in CHANNELS and need not in it.measured]
    return f"needs {' and '.join(lacking)}" if lacking else told[effect.told_by]


def _told(it: Installation, f: _Figures) -> dict[Told, str]:
    """Why nothing that needs this of an installation can be named; empty where it can."""
    blunt = "" if f.sight >= NAMING_RATIO else f"twist over noise is {f.sight:.2g}: naming wants {NAMING_RATIO:g}"
    late = "skew of the encoders: latch both on SYNC"
    torque = blunt if f.timing_carries else late
    return {
        "stiffness": "" if f.sight >= WRONG_RATIO else f"twist over noise is {f.sight:.2g}: below {WRONG_RATIO:g}",
        "angle": "" if WRONG_RATIO * f.noise_band_rad <= ARC_MINUTE_RMS_RAD else "1 arc-min is lost in twist noise",
        "timing": "" if it.timing.latched or it.timing.jitter_s <= abs(it.timing.skew_s) else "jitter hides it",
        "torque": torque,
        "output": blunt if it.timing.latched else late,
        "corners": blunt or torque or _below_corners(it, f),
        "zeros": "a difference of the encoders' zeros looks the same",
    }


def _below_corners(it: Installation, f: _Figures) -> str:
    if it.corner_2_Nm is None:
        return "T2 is not known"
    return "" if f.torque_peak_Nm > it.corner_2_Nm else f"needs more torque than T2 = {it.corner_2_Nm:g} N m"


def _advice(it: Installation, op: Operation, f: _Figures) -> str:
    """Timing before bits, bits before motion: whichever part of the error is largest."""
    perfect = replace(it, timing=Timing(True, 0.0, 0.0))
    still_rad = twist_noise_rad(perfect) * in_band(it)
    jitter_rad = op.speed_out_rad_s / math.sqrt(2) * it.timing.jitter_s
    if op.frequency_hz > it.cutoff_hz:
        return f"cutoff_hz: the motion at {op.frequency_hz:g} Hz is above the filter's {it.cutoff_hz:g} Hz: raise it."
    if not f.timing_carries or (jitter_rad > twist_noise_rad(perfect) and not it.timing.latched):
        gain = math.hypot(f.skew_rad, f.noise_band_rad) / still_rad
        return (
            "Latch both encoders on CAN SYNC (sync_period_s) or by wire, before buying bits: timing now costs "
            f"{gain:.2g} times what the encoder steps do."
        )
    if f.sight >= NAMING_RATIO:
        return "Nothing: effects can be named here. Sweep the torque past the gear's corners now and then."
    if jitter_rad > twist_noise_rad(perfect):
        jitter_us = it.timing.jitter_s * 1e6
        return f"Reduce the latch jitter ({jitter_us:.3g} us) by a common hardware latch, before buying bits."
    return _more_bits_or_motion(it, f)


def _more_bits_or_motion(it: Installation, f: _Figures) -> str:
    short = NAMING_RATIO / f.sight if f.sight else math.inf
    has = math.log2(it.counts_out)
    bits = has + math.log2(short) if math.isfinite(short) else math.inf
    motion = f"{short:.2g} times the acceleration (a faster reversal, or a known added inertia)"
    if bits > ENOUGH_BITS or it.noise_out_rad > 2 * math.pi / it.counts_out:
        return f"Move more: naming effects wants {motion}; encoder bits alone do not help here."
    return f"Move more, {motion}, or fit an output encoder of {math.ceil(bits)} bits instead of {has:.3g}."
