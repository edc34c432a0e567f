"""What the daemon estimates: one row each. Registers, topics, metrics, store and page are generated from it.

A row says where the number goes on Zenoh (`topic`). The order within a topic is the order a reader sees.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

TOPICS = ("health", "life", "stiffness", "noise", "load", "ratio", "model_error", "event", "meta")


@dataclass(frozen=True, slots=True)
class Quantity:
    name: str
    unit: str
    topic: str
    meaning: str


QUANTITIES: dict[str, Quantity] = {
    row.name: row
    for row in (
        Quantity("health_index", "1", "health", "1 = as commissioned, 0 = at the limit of use"),
        Quantity("damage", "1", "life", "fatigue damage of the flexspline: 0 new, 1 failure expected"),
        Quantity("rul_p10_h", "h", "life", "remaining life that 90 % of such gears exceed"),
        Quantity("rul_p50_h", "h", "life", "remaining life, median"),
        Quantity("rul_p90_h", "h", "life", "remaining life that 10 % of such gears exceed"),
        Quantity("operating_hours", "h", "life", "hours in which the motor turned so far"),
        Quantity("turns_in", "1", "life", "turns of the motor so far, both directions counted"),
        Quantity("turns_out", "1", "life", "turns of the output so far, both directions counted"),
        Quantity("load_cycles", "1", "life", "rainflow cycles of the torque so far, from 1 % of the rated torque on"),
        Quantity("stiffness", "N m/rad", "stiffness", "torsional stiffness at zero twist, seen from the output"),
        Quantity(
            "damping",
            "N m s/rad",
            "stiffness",
            "viscous damping of the twist, friction included",
        ),
        Quantity(
            "coulomb_friction",
            "N m",
            "stiffness",
            "friction torque of the twist, sign of its rate only",
        ),
        Quantity(
            "kinematic_error",
            "rad",
            "stiffness",
            "kinematic error at the output, peak to peak",
        ),
        Quantity(
            "stiffness_change",
            "1",
            "stiffness",
            "stiffness relative to the commissioning baseline, minus one",
        ),
        Quantity("stribeck_speed", "rad/s", "stiffness", "twist rate at which friction's excess has fallen to 1/e"),
        Quantity("hysteresis_width", "rad", "stiffness", "twist over which the hysteresis loop closes"),
        Quantity("hysteresis_state", "1", "stiffness", "where the hysteresis stands in its loop now, -1 to 1"),
        Quantity("half_gap", "rad", "stiffness", "half of the gap in which no torque is felt"),
        Quantity("hysteresis_area", "J", "stiffness", "torque-twist loop: work that stays in the gear per load cycle"),
        Quantity("noise_a0", "1/Hz", "noise", "coefficient of (f/f0)^0 in the noise spectrum, sensor unit squared"),
        Quantity("noise_a1", "1/Hz", "noise", "coefficient of (f/f0)^-1 in the noise spectrum, sensor unit squared"),
        Quantity("noise_a2", "1/Hz", "noise", "coefficient of (f/f0)^-2 in the noise spectrum, sensor unit squared"),
        Quantity("noise_a3", "1/Hz", "noise", "coefficient of (f/f0)^-3 in the noise spectrum, sensor unit squared"),
        Quantity("noise_a4", "1/Hz", "noise", "coefficient of (f/f0)^-4 in the noise spectrum, sensor unit squared"),
        Quantity("noise_rms", "1", "noise", "level in the fitted band, sensor unit"),
        Quantity("ratio", "1", "ratio", "transmission ratio: slope of the motor angle on the output angle"),
        Quantity(
            "ratcheting_events",
            "1",
            "ratio",
            "lasting twist jumps by whole tooth pitches so far",
        ),
        Quantity(
            "encoder_skew",
            "s",
            "ratio",
            "how much later the output encoder is sampled than the motor's; output-side viscous friction looks alike",
        ),
        Quantity("torque_rms", "N m", "load", "output torque, rms over the last minute"),
        Quantity("torque_peak", "N m", "load", "output torque, largest magnitude over the last minute"),
        Quantity(
            "torque_cubic_mean",
            "N m",
            "load",
            "output torque, cubic mean over the service life so far",
        ),
        Quantity("speed_in", "rad/s", "load", "motor speed, mean magnitude over the last minute"),
        Quantity("temperature", "degC", "load", "gear housing, mean over the last block"),
        Quantity("pressure", "Pa", "load", "gear housing, mean over the last block"),
        Quantity("temperature_ambient", "degC", "load", "air around the gear, mean over the last block"),
        Quantity("temperature_rise", "K", "load", "gear housing above the air around it"),
        Quantity("energy_lost_per_cycle", "J", "load", "work at the motor minus work at the output, per load cycle"),
        Quantity("efficiency", "1", "load", "work given over work taken, motor and output, over the last minute"),
        Quantity("model_nrmse", "1", "model_error", "rms of measured minus modelled torque over rms of measured"),
        Quantity("model_noise_floor", "1", "model_error", "what sensor noise alone would give for model_nrmse"),
        Quantity("model_rmse", "N m", "model_error", "rms of measured minus modelled torque"),
        Quantity("sound_angle_sd", "rad", "ratio", "motor angle heard in the sound: its sd per sample, motor side"),
        Quantity("sound_angle_slips", "1", "ratio", "cycles that the heard motor angle lost or gained so far"),
    )
}


ORDER_NAME = re.compile(
    r"(kinematic_error|encoder_eccentricity|torque_ripple|mesh_stiffness|wave_generator_ripple|load_ripple)"
    r"_\d+(_\d+)?(_(input|output|difference))?"
)
"""What the sizes of waves are called, which depend on the orders of each model: effect and order, e.g.
`kinematic_error_202_output`. They stand under `orders` in the topic `stiffness`."""


def is_known(name: str) -> bool:
    """Whether something of this name may be estimated."""
    return name in QUANTITIES or ORDER_NAME.fullmatch(name) is not None


def of_topic(topic: str) -> tuple[Quantity, ...]:
    """The quantities published under one Zenoh topic, in order."""
    return tuple(row for row in QUANTITIES.values() if row.topic == topic)
