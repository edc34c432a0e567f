"""Laws put together at random from what machines do, so that nobody has them in mind: an entrance (a spring, a gap, a
damper, friction, a load) times one or two things that it may depend on, or two such beside one another.

A set is its seed: `drawn(3)` is the third draw, `drawn(4)` the fourth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import copysign, exp, sin, tanh

import numpy as np
from fresh_laws import RUN_S
from numpy.random import Generator
from outside_laws import EDGE_RAD, OUTPUT_RAD_S, SLOPE_STEP_RAD_S, TWIST_RAD_S, Instant, Ranges, Stepwise

from edge_daemon.records import Array
from edge_daemon.rig.drive_truth import DriveTruth
from edge_daemon.rig.plant import Influence, Joint
from edge_daemon.rig.torsion_truth import LEAD_IN_S
from edge_daemon.rig.truths import Parameters, Scale, Truth

TORSION_LAWS, DRIVE_LAWS = 15, 5
"""of one draw"""


@dataclass(frozen=True, slots=True)
class LivedInstant(Instant):
    """With what the twist has been through."""

    since_s: float
    """since it turned round"""
    held: float
    """twist that a relaxing spring still holds"""


@dataclass(frozen=True, slots=True)
class Lived(Stepwise):
    """A law that also knows what the twist has been through."""

    relaxes_s: float = 1.0
    start: tuple[float, ...] = (-LEAD_IN_S, 0.0, 0.0, 0.0)

    def at(
        self, z: Sequence[float], step_s: float, phi: float, dphi: float, speed: float, angle: float
    ) -> tuple[float, float]:
        motor = self.joint.ratio * (angle + phi)

        def torque(dphi: float, speed: float) -> float:
            now = LivedInstant(phi, dphi, speed, angle, motor, z[0] + 0.5 * step_s, z[1], z[3])
            return self.law(now, self.p, self.joint)

        still = torque(dphi, speed)
        if not self.steep:
            return still, 0.0
        return still, (torque(dphi + SLOPE_STEP_RAD_S, speed - SLOPE_STEP_RAD_S) - still) / SLOPE_STEP_RAD_S

    def grown(self, z: Sequence[float], step_s: float, dphi: float) -> Sequence[float]:
        since = 0.0 if dphi * z[2] < 0 else z[1] + step_s
        return z[0] + step_s, since, copysign(1.0, dphi), (z[3] + step_s * dphi) * exp(-step_s / self.relaxes_s)


Part = Callable[[LivedInstant, Mapping[str, float]], float]
ENTRANCES: Mapping[str, tuple[Ranges, Part, bool]] = {
    "spring": ({"size": (0.2, 0.4)}, lambda i, p: i.phi / p["twist"], False),
    "gap": ({"size": (0.3, 0.6), "gap": (0.2, 0.6)},
            lambda i, p: -min(max(i.phi / p["twist"], -p["gap"]), p["gap"]), False),
    "cube": ({"size": (0.1, 0.2)}, lambda i, p: (i.phi / p["twist"]) ** 3, False),
    "damper": ({"size": (0.3, 0.6)}, lambda i, p: i.dphi / p["rate"], False),
    "twist friction": ({"size": (0.25, 0.45)}, lambda i, p: tanh(i.dphi / TWIST_RAD_S), True),
    "output friction": ({"size": (0.3, 0.6)}, lambda i, p: -tanh(i.speed / OUTPUT_RAD_S), True),
    "output drag": ({"size": (0.3, 0.6)}, lambda i, p: -i.speed / p["speed"], False),
    "load": ({"size": (0.4, 0.8)}, lambda i, p: -1.0, False),
    "relaxing spring": ({"size": (0.4, 0.7), "relaxes": (0.05, 0.5)}, lambda i, p: i.held / p["twist"], False),
}  # fmt: skip
"""(ranges, torque of size one, whether it is steep over the twist rate)"""
DEPENDS: Mapping[str, tuple[Ranges, Part, str]] = {
    "place": ({"k": (1.5, 12.0), "turn": (0.0, 6.28), "share": (0.4, 0.9)},
              lambda i, p: 1 + p["share"] * sin(p["k"] * i.angle + p["turn"]), "angle"),
    "motor place": ({"k": (0.4, 4.0), "turn": (0.0, 6.28), "share": (0.5, 0.9)},
                    lambda i, p: 1 + p["share"] * sin(p["k"] * i.motor + p["turn"]), "motor"),
    "sector": ({"at": (-0.1, 0.15)}, lambda i, p: 0.5 + 0.5 * tanh((i.angle - p["at"]) / EDGE_RAD), "angle"),
    "heat": ({"per_K": (0.04, 0.09)}, lambda i, p: exp(-p["per_K"] * i.warmer_K), "heat"),
    "age": ({"after": (4.0, 12.0)}, lambda i, p: exp(-max(i.time_s, 0.0) / p["after"]), "time"),
    "wear": ({}, lambda i, p: max(i.time_s, 0.0) / RUN_S, "time"),
    "load size": ({}, lambda i, p: min(abs(i.phi) / p["twist"], 4.0), "twist"),
    "load side": ({}, lambda i, p: float(i.phi > 0) * min(i.phi / p["twist"], 4.0), "twist"),
    "saturating load": ({"at": (0.4, 1.0)}, lambda i, p: tanh(abs(i.phi) / p["at"] / p["twist"]), "twist"),
    "one way": ({}, lambda i, p: 0.5 + 0.5 * tanh(i.speed / OUTPUT_RAD_S), "speed"),
    "speed size": ({"power": (0.5, 2.0)}, lambda i, p: min((abs(i.speed) / p["speed"]) ** p["power"], 4.0), "speed"),
    "rest": ({"forgets": (0.05, 0.3)}, lambda i, p: exp(-i.since_s / p["forgets"]), "history"),
}  # fmt: skip
"""(ranges, factor, the axis that it is of)"""
OWN_AXIS = {"spring": "twist", "gap": "twist", "cube": "twist", "output friction": "speed", "output drag": "speed"}

Course = Callable[[object, Parameters], Array]
DRIVE_ENTRANCES: Mapping[str, tuple[Ranges, Course]] = {
    "friction": ({"size": (0.4, 0.7)}, lambda m, p: m.sign),
    "drag": ({"size": (0.4, 0.7)}, lambda m, p: m.speed / np.std(m.speed)),
    "inertia": ({"size": (0.2, 0.4)}, lambda m, p: m.acceleration / np.std(m.acceleration)),
    "load": ({"size": (0.4, 0.7)}, lambda m, p: np.ones(len(m.time_s))),
    "churning": ({"size": (0.2, 0.4)}, lambda m, p: m.speed * np.abs(m.speed) / np.var(m.speed)),
}
DRIVE_DEPENDS: Mapping[str, tuple[Ranges, Course]] = {
    "place": ({"k": (1.0, 6.0), "turn": (0.0, 6.28)},
              lambda m, p: 1 + 0.8 * np.sin(p["k"] * m.theta_out_rad + p["turn"])),
    "motor place": ({"k": (0.3, 0.9), "turn": (0.0, 6.28)},
                    lambda m, p: 1 + 0.8 * np.sin(p["k"] * m.theta_in_rad + p["turn"])),
    "sector": ({"at": (-0.5, 0.5)}, lambda m, p: np.asarray(m.theta_out_rad > p["at"], dtype=float)),
    "heat": ({"per_K": (0.04, 0.09)}, lambda m, p: np.exp(-p["per_K"] * (m.temperature_degC - 25.0))),
    "age": ({"after": (4.0, 12.0)}, lambda m, p: np.exp(-m.time_s / p["after"])),
    "wear": ({}, lambda m, p: m.time_s / RUN_S),
    "one way": ({}, lambda m, p: np.asarray(m.speed > 0, dtype=float)),
    "load side": ({}, lambda m, p: np.maximum(m.acceleration, 0.0) / np.std(m.acceleration)),
}  # fmt: skip


def drawn(seed: int) -> tuple[Truth | DriveTruth, ...]:
    """The laws of one draw, each shape once."""
    rng = np.random.default_rng([2026, seed])
    laws: dict[str, Truth | DriveTruth] = {}
    while len(laws) < TORSION_LAWS:
        law: Truth | DriveTruth = _torsion(_shape(rng, list(ENTRANCES), list(DEPENDS), _fits))
        laws.setdefault(law.name, law)
    while len(laws) < TORSION_LAWS + DRIVE_LAWS:
        law = _drive(_shape(rng, list(DRIVE_ENTRANCES), list(DRIVE_DEPENDS), lambda entrance, factors: True))
        laws.setdefault(law.name, law)
    return tuple(laws.values())


Shape = tuple[tuple[str, tuple[str, ...]], ...]
"""Summands: an entrance, and what it depends on."""


def _fits(entrance: str, factors: Sequence[str]) -> bool:
    """No axis twice, since one factor of it would do."""
    axes = [OWN_AXIS.get(entrance, entrance), *(DEPENDS[name][2] for name in factors)]
    return len(set(axes)) == len(axes)


def _shape(
    rng: Generator, entrances: Sequence[str], depends: Sequence[str], fits: Callable[[str, Sequence[str]], bool]
) -> Shape:
    while True:
        counts = ((1,), (1,), (2,), (1, 1))[int(rng.integers(4))]
        rows = [(str(rng.choice(entrances)), tuple(map(str, rng.choice(depends, n, replace=False)))) for n in counts]
        if len({entrance for entrance, _ in rows}) == len(rows) and all(fits(*row) for row in rows):
            return tuple(rows)


def _named(shape: Shape) -> str:
    return "_beside_".join(f"{entrance} by {' and '.join(factors)}".replace(" ", "_") for entrance, factors in shape)


def _numbers(shape: Shape, rows: Sequence[Mapping[str, Ranges]]) -> Ranges:
    """Every number of a shape, told apart by its summand."""
    return {
        f"{name}{at}": ends
        for at, (entrance, factors) in enumerate(shape)
        for ranges in (rows[0][entrance], *(rows[1][factor] for factor in factors))
        for name, ends in ranges.items()
    }


def _own(p: Parameters, at: int) -> dict[str, float]:
    """The numbers of one summand, and the scales."""
    return {
        name.removesuffix(str(at)): value for name, value in p.items() if not name[-1].isdigit() or name[-1] == str(at)
    }


def _torsion(shape: Shape) -> Truth:
    first, second = ({name: row[0] for name, row in table.items()} for table in (ENTRANCES, DEPENDS))
    ranges = _numbers(shape, (first, second))  # type: ignore[arg-type]

    def draw(rng: Generator, scale: Scale, joint: Joint) -> dict[str, float]:
        rows = {key: float(rng.uniform(*ends)) for key, ends in ranges.items()}
        rows |= {key: value * scale.torque_Nm for key, value in rows.items() if key.startswith("size")}
        return rows | {"twist": scale.twist_rad, "rate": scale.twist_rate_rad_s, "speed": scale.speed_out_rad_s}

    def build(p: Parameters, joint: Joint) -> Influence:
        own = [_own(p, at) for at in range(len(shape))]

        def law(i: LivedInstant, _: Parameters, j: Joint) -> float:
            total = 0.0
            for mine, (entrance, factors) in zip(own, shape, strict=True):
                torque = mine["size"] * ENTRANCES[entrance][1](i, mine)
                for factor in factors:
                    torque *= DEPENDS[factor][1](i, mine)
                total += torque
            return total

        steep = any(ENTRANCES[entrance][2] for entrance, _ in shape)
        relaxes = next((mine["relaxes"] for mine in own if "relaxes" in mine), 1.0)
        return Influence(twist=Lived(law, p, joint, steep, relaxes_s=relaxes))

    return Truth(_named(shape), "drawn", draw, build, any("heat" in factors for _, factors in shape))


def _drive(shape: Shape) -> DriveTruth:
    first, second = ({name: row[0] for name, row in table.items()} for table in (DRIVE_ENTRANCES, DRIVE_DEPENDS))

    def torque(m: object, p: Parameters) -> Array:
        total = np.zeros(len(m.time_s))  # type: ignore[attr-defined]
        for at, (entrance, factors) in enumerate(shape):
            own = _own(p, at)
            part = own["size"] * DRIVE_ENTRANCES[entrance][1](m, own)
            for factor in factors:
                part = part * DRIVE_DEPENDS[factor][1](m, own)
            total = total + part
        return total

    ranges = _numbers(shape, (first, second))  # type: ignore[arg-type]

    def draw(rng: Generator, rms: float) -> dict[str, float]:
        rows = {key: float(rng.uniform(*ends)) for key, ends in ranges.items()}
        return {key: value * rms if key.startswith("size") else value for key, value in rows.items()}

    return DriveTruth(_named(shape), draw, torque, warms=any("heat" in factors for _, factors in shape))
