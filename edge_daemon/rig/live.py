"""One simulated drive that runs on: integrated up to a given instant, read through its sensors.

Knows no clock: the caller says how far to go, so tests run it as fast as it goes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge_daemon.records import Array
from edge_daemon.rig.motion import MotorMotion, live
from edge_daemon.rig.plant import Influence, Joint, Plant, off_centre, stages
from edge_daemon.rig.sensors import Counts, EncoderFace, Housing, Microphone
from edge_daemon.rig.simulated import WARM_UP_K, Given, UnknownEffect
from edge_daemon.rig.truths import TRUTHS, Scale, scale_of

DEMO_JOINT = Joint(inertia_kg_m2=0.05, stiffness_Nm_per_rad=1e5, damping_Nms_per_rad=12.0, ratio=100.0)
"""The articles' table gives inertia and stiffness; the damping is chosen: 8.5 per cent of critical."""
ARC_MIN_RAD = math.pi / 10_800
DEMO_EFFECTS: dict[str, dict[str, float]] = {
    "kinematic_error": {"order2_rad": 0.5 * ARC_MIN_RAD, "order4_rad": 0.0, "order1_rad": 0.0},
    "coulomb_friction": {"level_Nm": 1.0},
}
"""Beyond stiffness and damping the demo's gear has 1 arc-min peak to peak (catalogue) and modest dry friction."""
RATE_HZ = 1000.0
STEP_S = 2.5e-4
"""4 kHz, half of a recording's, because a Raspberry Pi has to keep up: errs by 1e-5 of the twist"""
SCALE_S = 60.0
"""The sizes of its effects are drawn by so much of its motion."""
STIFFNESS_LOSS = 0.3
"""From new (wear 0) to worn out (wear 1) this share of stiffness goes (chosen)."""
LATEST_SENSOR_S = 0.05
"""The oldest motion that a late sensor may tell of; amplifiers and buses of servo drives stay below (guess)."""
MOTOR_INERTIA_KG_M2 = 3e-5
MOTOR_FRICTION_NM = 0.03
MOTOR_DAMPING_NMS_PER_RAD = 2e-4
TORQUE_CONSTANT_NM_PER_A = 0.12
"""Motor and its friction are those of a 400 W servo, rounded."""


@dataclass(frozen=True, slots=True)
class Samples:
    """What one drive's devices latched, (n,) each."""

    time_s: Array
    """rig time"""
    counts_in: Counts
    counts_out: Counts
    motor_torque_Nm: Array
    motor_current_A: Array
    motor_speed_rad_s: Array
    kept_in: NDArray[np.bool_]
    """False where the encoder's frame gets lost"""
    kept_out: NDArray[np.bool_]
    kept_drive: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(slots=True)
class LiveDrive:
    """State and sensors of one drive."""

    plant: Plant
    motion: MotorMotion
    encoder_in: EncoderFace
    encoder_out: EncoderFace
    microphone: Microphone
    housing: Housing
    truth: dict[str, object]
    wear: float = 0.0
    """0 new, 1 worn out"""
    wear_per_s: float = 0.0
    time_s: float = 0.0
    torque_gain: float = 1.0
    """what the servo drive tells of torque and current, over the truth"""
    torque_delay_s: float = 0.0
    torque_limit_Nm: float = math.inf
    """beyond which torque and current are not told"""
    exchanged: bool = False
    """the encoders' cables are plugged the wrong way round"""
    silent: bool = False
    """its bus is cut: nothing that it latches arrives"""
    added: dict[str, Influence] = field(default_factory=dict)
    """what happened to the gear since it was made, by the name of the fault"""
    _samples: int = field(default=0)
    recent: tuple[Array, Array, Array] = (np.zeros(1), np.zeros(1), np.zeros(1))
    """(n,) each: time [s], twist [rad] and twist rate [rad/s] of the newest substeps, for sensors that are late"""

    def advance(self, until_s: float) -> Samples:
        """Everything latched after `time_s` and up to `until_s` (rig time), one sample per millisecond."""
        n = max(0, math.floor(until_s * RATE_HZ + 1e-6) - self._samples)
        every = round(1.0 / (RATE_HZ * STEP_S))
        latch_s: Array = (self._samples + 1.0 + np.arange(n, dtype=np.float64)) / RATE_HZ
        inside_s: Array = stages(self._samples * every, n * every, STEP_S)
        self._grow_old(n / RATE_HZ)
        heat = np.full(len(inside_s), self.housing.temperature_degC)
        twist, rate = self.plant.run(inside_s, self.motion.course(inside_s), heat)
        self._remember(np.arange(1.0, n * every + 1) * STEP_S + self._samples / RATE_HZ, twist, rate)
        self._samples += n
        self.time_s = self._samples / RATE_HZ
        if n:
            self.housing.advance(n / RATE_HZ, float(np.abs(self.motion.course(latch_s).speed).mean()))
        return self._latched(latch_s)

    def _latched(self, latch_s: Array) -> Samples:
        """What the devices tell of these instants."""
        n = len(latch_s)
        age_in_s, age_out_s = (encoder.ages(n, 1.0 / RATE_HZ) for encoder in (self.encoder_in, self.encoder_out))
        counts_in = self.encoder_in.counts(self.motion.course(latch_s - age_in_s).angle)
        counts_out = self.encoder_out.counts(self._output_angle(latch_s - age_out_s))
        if self.exchanged:
            counts_in, counts_out = counts_out, counts_in
        torque = self.torque_gain * self._motor_torque(latch_s - self.torque_delay_s)
        torque = np.clip(torque, -self.torque_limit_Nm, self.torque_limit_Nm)
        heard = np.full(n, not self.silent)
        return Samples(
            latch_s,
            counts_in,
            counts_out,
            torque,
            torque / TORQUE_CONSTANT_NM_PER_A,
            self.motion.course(latch_s).speed,
            self.encoder_in.kept(n) & heard,
            self.encoder_out.kept(n) & heard,
            heard,
        )

    def _output_angle(self, time_s: Array) -> Array:
        """(n,) what an ideal encoder on the output's disc says at these instants [rad]."""
        u, (twist, rate) = self.plant.input_angle(self.motion.course(time_s)), self._twist(time_s)
        skew_s = sum(influence.skew_s for influence in self.plant.influences)
        return off_centre(u.angle - twist + skew_s * (u.speed - rate), self.plant.influences)

    def _remember(self, time_s: Array, twist_rad: Array, rate_rad_s: Array) -> None:
        tail = round(LATEST_SENSOR_S / STEP_S)
        before, new = self.recent, (time_s, twist_rad, rate_rad_s)
        times, twists, rates = (np.concatenate((old[-tail:], row)) for old, row in zip(before, new, strict=True))
        self.recent = (times, twists, rates)

    def _twist(self, time_s: Array) -> tuple[Array, Array]:
        """(n,) twist [rad] and twist rate [rad/s] at instants not older than `LATEST_SENSOR_S`."""
        known_s, twist, rate = self.recent
        return np.interp(time_s, known_s, twist), np.interp(time_s, known_s, rate)

    def skip(self, seconds: float) -> None:
        """Leaves out a stretch of time that the computer was too busy for."""
        self._samples += round(seconds * RATE_HZ)
        self.time_s = self._samples / RATE_HZ

    def sound(self, samples: int, rate_hz: float) -> Array:
        """(samples,) sound pressure [Pa] from now on."""
        self.microphone.wear = self.wear
        at: Array = self.time_s + np.arange(samples, dtype=np.float64) / rate_hz
        return self.microphone.waveform(self.motion.course(at).angle, rate_hz)

    def bands(self, frequency_hz: Array, averages: float) -> Array:
        """(n,) band levels [Pa^2/Hz] now."""
        self.microphone.wear = self.wear
        return self.microphone.bands(frequency_hz, averages)

    def _grow_old(self, seconds: float) -> None:
        self.wear = min(1.0, self.wear + self.wear_per_s * seconds)
        self.plant.stiffness_scale = 1.0 - STIFFNESS_LOSS * self.wear

    def _motor_torque(self, time_s: Array) -> Array:
        motor, (twist, rate) = self.motion.course(time_s), self._twist(time_s)
        known_s, _, rates = self.recent
        second = np.zeros_like(rates)  # from the past alone, so that it is the same however the time is cut
        second[2:] = (3 * rates[2:] - 4 * rates[1:-1] + rates[:-2]) / (2 * STEP_S)
        carried = self.plant.carried(time_s, (twist, rate, np.interp(time_s, known_s, second)), motor)
        gear = carried * self.plant.lever(motor.angle)
        friction = MOTOR_FRICTION_NM * np.tanh(motor.speed) + MOTOR_DAMPING_NMS_PER_RAD * motor.speed
        return np.asarray(gear + MOTOR_INERTIA_KG_M2 * motor.acceleration + friction)


def live_drive(
    seed: int,
    effects: Sequence[str] | None = None,
    joint: Joint = DEMO_JOINT,
    bits_in: int = 17,
    bits_out: int = 24,
    wear: float = 0.0,
    wear_per_s: float = 0.0,
    parameters: Mapping[str, float] | None = None,
) -> LiveDrive:
    """A drive that moves for ever, everything drawn from `seed`; `effects` None means the demo's.

    `parameters` overrides drawn ones by `effect.name`. Raises `UnknownEffect`.
    """
    rng = np.random.default_rng(seed)
    motion = live(rng)
    scale = scale_of(joint, motion, SCALE_S, WARM_UP_K)
    demos = DEMO_EFFECTS if effects is None else {}
    fixed = {f"{effect}.{name}": value for effect, values in demos.items() for name, value in values.items()}
    given = Given({**fixed, **(parameters or {})})
    chosen = {name: given.of(name, _drawn(name, rng, scale, joint)) for name in effects or demos}
    influences: list[Influence] = [TRUTHS[name].build(values, joint) for name, values in chosen.items()]
    microphone = Microphone(rng)
    truth = _truth(seed, joint, chosen, microphone, (bits_in, bits_out), scale)
    return LiveDrive(
        Plant(joint, influences, step_s=STEP_S),
        motion,
        EncoderFace(bits_in, rng),
        EncoderFace(bits_out, rng),
        microphone,
        Housing(rng),
        truth,
        wear,
        wear_per_s,
    )


def _drawn(name: str, rng: np.random.Generator, scale: Scale, joint: Joint) -> dict[str, float]:
    if name not in TRUTHS:
        raise UnknownEffect(name, TRUTHS)
    return TRUTHS[name].draw(rng, scale, joint)


def _truth(
    seed: int,
    joint: Joint,
    chosen: Mapping[str, Mapping[str, float]],
    microphone: Microphone,
    bits: tuple[int, int],
    scale: Scale,
) -> dict[str, object]:
    return {
        "seed": seed,
        "inertia_kg_m2": joint.inertia_kg_m2,
        "stiffness_Nm_per_rad": joint.stiffness_Nm_per_rad,
        "damping_Nms_per_rad": joint.damping_Nms_per_rad,
        "ratio": joint.ratio,
        "effects": list(chosen),
        "parameters": {f"{effect}.{key}": value for effect, values in chosen.items() for key, value in values.items()},
        "kinematic_error_pp_rad": 2 * chosen.get("kinematic_error", {}).get("order2_rad", 0.0),
        "noise_reference_hz": 300.0,
        "noise_coefficients": list(microphone.coefficients),
        "noise_unit": "Pa^2/Hz",
        "bits_in": bits[0],
        "bits_out": bits[1],
        "rigid_torque_rms_Nm": scale.torque_Nm,
    }
