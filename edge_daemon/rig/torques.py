"""Torques that depend on the twist or the output from instant to instant, as the simulated drive feels them.

`sgn` is `tanh(rate / width)`: the width is stated with each. Torque is on the output side, positive with the twist;
loads on the output count negative.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import copysign, exp, pow, sin, tanh

from edge_daemon.rig.plant import SUBSTEP_S

REVERSAL_WIDTH_RAD_S = 1e-3
"""Friction turns round over this twist rate; the rates in use are some 1e-2."""
OUTPUT_WIDTH_RAD_S = 1e-2
"""Output friction turns round over this output speed; speeds in use are some rad/s."""


class Memoryless:
    """Base of those without state."""

    def keep(self, dphi: float) -> None:
        """Nothing to remember."""


@dataclass(slots=True)
class Polynomial(Memoryless):
    """k1*phi^2 + k2*phi^3"""

    k1: float
    k2: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        return (self.k1 + self.k2 * phi) * phi * phi, 0.0


@dataclass(slots=True)
class Piecewise(Memoryless):
    """Stiffer beyond the corner twists `p1` and `p2` by `step1` and `step2` [N m/rad]."""

    p1: float
    p2: float
    step1: float
    step2: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        size = abs(phi)
        torque = self.step1 * max(0.0, size - self.p1) + self.step2 * max(0.0, size - self.p2)
        return copysign(torque, phi), 0.0


@dataclass(slots=True)
class DeadZone(Memoryless):
    """Takes the spring away within +-half the gap: -K*clip(phi)."""

    half_gap: float
    stiffness: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        return -self.stiffness * max(-self.half_gap, min(self.half_gap, phi)), 0.0


@dataclass(slots=True)
class Coulomb(Memoryless):
    """Fc * sgn(dphi)"""

    level: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        sign = tanh(dphi / REVERSAL_WIDTH_RAD_S)
        return self.level * sign, self.level * (1.0 - sign * sign) / REVERSAL_WIDTH_RAD_S


@dataclass(slots=True)
class Stribeck(Memoryless):
    """(Fc + (Fs - Fc)*exp(-(dphi/vs)^2)) * sgn(dphi)"""

    level: float
    static: float
    stribeck_rad_s: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        sign = tanh(dphi / REVERSAL_WIDTH_RAD_S)
        x = dphi / self.stribeck_rad_s
        bump = (self.static - self.level) * exp(-x * x) if -20.0 < x < 20.0 else 0.0
        slope = (self.level + bump) * (1.0 - sign * sign) / REVERSAL_WIDTH_RAD_S
        return (self.level + bump) * sign, slope - 2 * x / self.stribeck_rad_s * bump * sign


def tooth_friction(mu: float, carried: float, slope: float, dphi: float) -> tuple[float, float]:
    """mu * |tau| * sgn(dphi), where tau is all that passes the teeth: what is carried, and this friction itself.

    Amontons' law; the force between the teeth is in proportion to the torque that passes them.
    """
    sign = tanh(dphi / REVERSAL_WIDTH_RAD_S)
    share = mu * sign * copysign(1.0, carried)
    passed = carried / (1.0 - share)
    turning = mu * abs(passed) * (1.0 - sign * sign) / REVERSAL_WIDTH_RAD_S
    return share * passed, (turning + share * slope) / (1.0 - share)


@dataclass(slots=True)
class BoucWen:
    """level * z, z' = dphi/knee * (1 - |z|^n * (beta*sgn(dphi*z) + 1 - beta)); Wen 1976, J. Eng. Mech. 102."""

    level: float
    knee_rad: float
    beta: float
    n: float = 1.0
    _z: float = field(default=0.0)

    def _grown(self, dphi: float) -> float:
        z, travel = self._z, dphi * SUBSTEP_S / self.knee_rad
        shape = self.beta * (1.0 if dphi * z > 0 else -1.0) + 1.0 - self.beta
        trial = z + 0.5 * travel * (1.0 - pow(abs(z), self.n) * shape)
        return z + travel * (1.0 - pow(abs(trial), self.n) * shape)

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        return self.level * 0.5 * (self._z + self._grown(dphi)), 0.0

    def keep(self, dphi: float) -> None:
        self._z = self._grown(dphi)


@dataclass(slots=True)
class MaxwellSlip:
    """Springs that slip at their own limits: sum of k_i * z_i, |z_i| <= limit_i; Lampaert 2003."""

    stiffness: tuple[float, ...]
    limit_rad: tuple[float, ...]
    _z: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._z = [0.0] * len(self.stiffness)

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        travel, total = dphi * SUBSTEP_S, 0.0
        for k, limit, z in zip(self.stiffness, self.limit_rad, self._z, strict=True):
            after = z + travel
            total += k * (z + (limit if after > limit else -limit if after < -limit else after))
        return 0.5 * total, 0.0

    def keep(self, dphi: float) -> None:
        travel = dphi * SUBSTEP_S
        after = [z + travel for z in self._z]
        self._z = [m if z > m else -m if z < -m else z for m, z in zip(self.limit_rad, after, strict=True)]


@dataclass(slots=True)
class LuGre:
    """s0*z + s1*z' with z' = dphi - s0*|dphi|*z/g(dphi); Canudas de Wit et al. 1995, IEEE TAC 40(3), eq. (2)-(5)."""

    level: float
    static: float
    stribeck_rad_s: float
    bristle_Nm_per_rad: float
    bristle_Nms_per_rad: float
    _z: float = field(default=0.0)

    def _rate(self, z: float, dphi: float) -> float:
        x = dphi / self.stribeck_rad_s
        g = self.level + (self.static - self.level) * (exp(-x * x) if -20.0 < x < 20.0 else 0.0)
        return dphi - self.bristle_Nm_per_rad * abs(dphi) * z / g

    def _grown(self, dphi: float) -> float:
        trial = self._z + 0.5 * SUBSTEP_S * self._rate(self._z, dphi)
        return self._z + SUBSTEP_S * self._rate(trial, dphi)

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        z = self._grown(dphi)
        growth = (z - self._z) / SUBSTEP_S
        return self.bristle_Nm_per_rad * 0.5 * (self._z + z) + self.bristle_Nms_per_rad * growth, 0.0

    def keep(self, dphi: float) -> None:
        self._z = self._grown(dphi)


@dataclass(slots=True)
class Dahl:
    """dF/dphi = s*(1 - F/Fc*sgn(dphi)); Dahl 1976, AIAA J. 14(12), eq. (7) with exponent 1: exact over a substep."""

    level: float
    rest_Nm_per_rad: float
    _torque: float = field(default=0.0)

    def _grown(self, dphi: float) -> float:
        end = copysign(self.level, dphi)
        return end + (self._torque - end) * exp(-self.rest_Nm_per_rad * abs(dphi) * SUBSTEP_S / self.level)

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        return 0.5 * (self._torque + self._grown(dphi)), 0.0

    def keep(self, dphi: float) -> None:
        self._torque = self._grown(dphi)


@dataclass(slots=True)
class Gravity(Memoryless):
    """Load of an unbalanced mass: -(sine*sin(theta_out) + cosine*cos(theta_out))."""

    size_Nm: float
    phase_rad: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        return -self.size_Nm * sin(angle + self.phase_rad), 0.0


@dataclass(slots=True)
class OutputFriction(Memoryless):
    """Bearing friction against the output speed, viscous and Coulomb: a load, hence negative."""

    viscous_Nms_per_rad: float
    coulomb_Nm: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        sign = tanh(speed / OUTPUT_WIDTH_RAD_S)
        slope = self.viscous_Nms_per_rad + self.coulomb_Nm * (1.0 - sign * sign) / OUTPUT_WIDTH_RAD_S
        return -self.viscous_Nms_per_rad * speed - self.coulomb_Nm * sign, slope


@dataclass(slots=True)
class SpeedWave(Memoryless):
    """Not in any catalogue: a torque periodic in the output speed."""

    size_Nm: float
    period_rad_s: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        return self.size_Nm * sin(6.283185307179586 * speed / self.period_rad_s), 0.0


@dataclass(slots=True)
class TwistTimesAngle(Memoryless):
    """Not in any catalogue: a stiffness that depends on where the output stands."""

    stiffness: float
    order: float
    phase_rad: float

    def at(self, phi: float, dphi: float, speed: float, angle: float) -> tuple[float, float]:
        return self.stiffness * phi * sin(self.order * angle + self.phase_rad), 0.0
