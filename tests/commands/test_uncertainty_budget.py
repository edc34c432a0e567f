"""What an installation can see, against simulated encoders that share no formula with the budget."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.commands.uncertainty_budget import (
    Installation,
    Operation,
    Timing,
    budget,
    in_band,
    installation_of,
    smallest_loss,
    timing_of,
    twist_noise_rad,
)
from edge_daemon.config.reading import load
from edge_daemon.effects.catalogue import of_balance
from edge_daemon.motion.kinematics import filters

SPEED = math.pi  # rad/s: 3000 rpm behind 100:1
LATCHED = Timing(True, 0.0, 0.0)
PLAIN = Installation(2.0**20, 2.0**20, 1000.0, 100.0, 0.05, 100.0, 1e5, LATCHED)


@pytest.mark.parametrize(
    ("frequency_hz", "torque", "phi", "step_over_phi", "sd"),
    [
        (1.0, 1.0, 9.9e-6, (4.9, 0.61, 0.076), 1.0e-3),
        (5.0, 4.9, 4.9e-5, (0.97, 0.12, 0.015), 2.0e-4),
        (20.0, 19.7, 2.0e-4, (0.24, 0.030, 0.0038), 5.1e-5),
    ],
)
def test_the_known_table_of_sizes(
    frequency_hz: float, torque: float, phi: float, step_over_phi: tuple[float, ...], sd: float
) -> None:
    seen = budget(PLAIN, Operation(frequency_hz, SPEED))
    assert seen.figure("torque_peak") == pytest.approx(torque, rel=0.02)
    assert seen.figure("twist_rms") * math.sqrt(2) == pytest.approx(phi, rel=0.02)
    assert seen.figure("stiffness_sd") == pytest.approx(sd, rel=0.02)
    for bits, share in zip((17, 20, 23), step_over_phi, strict=True):
        noise = twist_noise_rad(replace(PLAIN, counts_out=2.0**bits)) * math.sqrt(12)
        assert noise / phi == pytest.approx(share, rel=0.03)


@pytest.mark.parametrize(("stiffness", "floor"), [(2e4, 0.02), (1e5, 0.11)])
def test_torque_floor_of_twenty_bits(stiffness: float, floor: float) -> None:
    noisy = replace(PLAIN, stiffness_Nm_per_rad=stiffness, noise_out_rad=0.3 * 2 * math.pi / 2**20)
    assert budget(noisy, Operation(5.0, 3.0)).figure("torque_floor") == pytest.approx(floor, rel=0.13)


def test_skew_reads_as_friction_and_as_twist() -> None:
    skewed = replace(PLAIN, stiffness_Nm_per_rad=2e4, timing=Timing(True, 0.0, 20e-6))
    assert budget(skewed, Operation(5.0, 3.0)).figure("skew_friction") == pytest.approx(0.4)
    free = replace(PLAIN, timing=Timing(False, 0.0, 0.5e-3))
    assert budget(free, Operation(5.0, 3.0)).figure("skew_twist") * math.sqrt(2) == pytest.approx(1.5e-3)


def sampled(it: Installation, op: Operation, seconds: float, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Two step-wise encoders on a rigid sine: time, true twist, measured twist."""
    time_s = np.arange(round(seconds * it.rate_hz)) / it.rate_hz
    omega = 2 * math.pi * op.frequency_hz
    start, phase = rng.uniform(0, 1), rng.uniform(0, 2 * math.pi)

    def output(t: np.ndarray) -> np.ndarray:
        return start + op.speed_out_rad_s / omega * np.sin(omega * t + phase)

    twist = -it.inertia_kg_m2 * omega**2 * (output(time_s) - start) / it.stiffness_Nm_per_rad
    motor = it.ratio * (output(time_s) + twist) + rng.normal(0, 1, len(time_s)) * it.noise_in_rad
    late = output(time_s + rng.normal(0, 1, len(time_s)) * it.timing.jitter_s)
    late = late + rng.normal(0, 1, len(time_s)) * it.noise_out_rad
    step_in, step_out = 2 * math.pi / it.counts_in, 2 * math.pi / it.counts_out
    return time_s, twist, np.floor(motor / step_in) * step_in / it.ratio - np.floor(late / step_out) * step_out


CASES = [
    PLAIN,
    replace(PLAIN, counts_in=2.0**12),  # the motor encoder's steps count too
    replace(PLAIN, counts_out=2.0**23, noise_out_rad=3e-6, noise_in_rad=2e-4),
    replace(PLAIN, counts_out=2.0**23, timing=Timing(True, 2e-6, 0.0)),
]


@pytest.mark.parametrize("it", CASES)
def test_noise_and_floor_against_simulated_encoders(it: Installation) -> None:
    op = Operation(7.3, SPEED)
    rng = np.random.default_rng(11)
    _, twist, measured = sampled(it, op, 20.0, rng)
    error = measured - twist - (measured - twist).mean()
    seen = budget(it, op)
    assert error.std() == pytest.approx(seen.figure("twist_noise"), rel=0.03)
    fir = filters(it.rate_hz, it.cutoff_hz)
    passed = fir.apply(fir.value, error)[fir.delay : -fir.delay]
    floor = it.stiffness_Nm_per_rad * passed.std()
    assert floor == pytest.approx(seen.figure("torque_floor"), rel=0.12)  # the filter's edge is not a wall


@pytest.mark.parametrize("it", CASES)
def test_stiffness_sd_against_the_scatter_of_repeated_records(it: Installation) -> None:
    op = Operation(7.3, SPEED)
    rng = np.random.default_rng(5)
    found = []
    for _ in range(200):
        _, twist, measured = sampled(it, op, 1.0, rng)
        torque = it.stiffness_Nm_per_rad * (twist - twist.mean())
        found.append((torque @ torque) / (torque @ (measured - measured.mean())))
    scatter = np.std(found) / it.stiffness_Nm_per_rad
    assert np.mean(found) == pytest.approx(it.stiffness_Nm_per_rad, rel=4 * scatter / math.sqrt(200))
    assert scatter / math.sqrt(60) == pytest.approx(budget(it, op).figure("stiffness_sd"), rel=0.2)


def test_smallest_loss_is_noticed_and_rarely_imagined() -> None:
    rng = np.random.default_rng(3)
    sd_hour, loss = 1e-4, smallest_loss(1e-4, 3600.0, 7200.0)
    baseline = rng.normal(0, sd_hour / math.sqrt(2), 200_000)  # learned from two hours
    healthy, worn = (rng.normal(mean, sd_hour, 200_000) - baseline for mean in (0.0, -loss))
    assert (healthy < -loss / 2).mean() == pytest.approx(0.01, rel=0.1)
    assert (worn < -loss / 2).mean() == pytest.approx(0.99, rel=0.002)


def test_advice_timing_before_bits() -> None:
    op = Operation(20.0, SPEED)
    free = replace(PLAIN, counts_out=2.0**17, timing=Timing(False, 1e-4, 0.5e-3))
    assert "SYNC" in budget(free, op).advice and "before buying bits" in budget(free, op).advice
    latched = budget(replace(free, timing=LATCHED), op)
    assert "SYNC" not in latched.advice and "bits instead of 17" in latched.advice
    assert budget(replace(PLAIN, counts_out=2.0**24), op).advice.startswith("Nothing")


def test_the_advised_bits_do_what_was_promised() -> None:
    op = Operation(5.0, SPEED)
    poor = replace(PLAIN, counts_out=2.0**18)
    words = budget(poor, op).advice.split()
    bits = int(words[words.index("bits") - 1])
    assert budget(replace(poor, counts_out=2.0**bits), op).figure("twist_over_noise") >= 68
    assert budget(replace(poor, counts_out=2.0 ** (bits - 1)), op).figure("twist_over_noise") < 70


def test_what_can_be_named_grows_with_sight() -> None:
    slow, fast = (
        budget(PLAIN, Operation(0.05, SPEED)),
        budget(replace(PLAIN, counts_out=2.0**24), Operation(20.0, SPEED)),
    )
    assert "only that something is wrong" in {row.name: row.meaning for row in slow.rows}["twist_over_noise"]
    assert "linear_stiffness" not in slow.named and "coulomb_friction" not in slow.named
    assert {"coulomb_friction", "kinematic_error", "output_viscous_friction"} <= set(fast.named)
    assert "piecewise_stiffness" not in fast.named  # T2 is not known
    strong = replace(PLAIN, counts_out=2.0**24, inertia_kg_m2=0.5, corner_1_Nm=7.0, corner_2_Nm=25.0)
    assert "piecewise_stiffness" in budget(strong, Operation(20.0, SPEED)).named


def test_every_effect_is_named_or_refused_for_a_reason() -> None:
    motion, poor = Operation(20.0, SPEED), Timing(False, 1e-6, 0.5e-3)
    for it in (PLAIN, replace(PLAIN, timing=poor), replace(PLAIN, counts_out=2.0**24, corner_2_Nm=1.0)):
        seen = budget(it, motion)
        refused = [name for names, why in seen.refused for name in names.split(", ") if why]
        assert sorted([*seen.named, *refused]) == sorted(row.name for row in of_balance("torsion"))


def test_what_needs_a_channel_is_named_where_there_is_one() -> None:
    sharp = replace(PLAIN, counts_out=2.0**24)
    blind = budget(sharp, Operation(20.0, SPEED))
    assert not {"temperature_friction", "inertia_error"} & set(blind.named)
    assert any("temperature_friction" in names and "temperature_degC" in why for names, why in blind.refused)
    full = replace(sharp, measured=sharp.measured | {"temperature_degC", "torque_out_Nm"})
    assert {"temperature_friction", "inertia_error"} <= set(budget(full, Operation(20.0, SPEED)).named)


def test_free_running_stamps_refuse_torque_effects() -> None:
    free = replace(PLAIN, counts_out=2.0**24, timing=Timing(False, 1e-6, 0.5e-3))
    seen = budget(free, Operation(20.0, SPEED))
    assert "coulomb_friction" not in seen.named
    assert any("coulomb_friction" in effects and "SYNC" in why for effects, why in seen.refused)


def test_a_motion_above_the_filter_is_not_seen() -> None:
    seen = budget(PLAIN, Operation(150.0, SPEED))
    assert seen.figure("twist_rms") == 0 and math.isinf(seen.figure("smallest_loss"))
    assert "cutoff_hz" in seen.advice


def test_live_noise_replaces_the_computed_one() -> None:
    assert budget(PLAIN, Operation(5.0, SPEED), measured_noise_rad=1e-5).figure("twist_noise") == 1e-5


def test_figures_come_from_the_configuration() -> None:
    settings = load(Path(__file__).parents[2] / "config" / "gateway.toml")
    drive = settings.drive[0]
    it = installation_of(settings, drive, ratio=100.0, inertia_kg_m2=0.05, stiffness_Nm_per_rad=1.6e4)
    assert it is not None and (it.counts_in, it.counts_out, it.rate_hz) == (131072, 16777216, 1000.0)
    assert it.timing.latched  # sync_period_s
    unlatched = type(settings)(can=(type(settings.can[0])(name="can0", channel="can0"),), drive=settings.drive)
    assert timing_of(unlatched, drive).skew_s == pytest.approx(0.5e-3)
    one_sided = type(drive)(name="a", modbus_device_id=1, model="m", channels=drive.channels[:1])
    assert installation_of(settings, one_sided, ratio=1.0, inertia_kg_m2=1.0, stiffness_Nm_per_rad=1.0) is None
    assert in_band(it) == pytest.approx(math.sqrt(0.2))
