"""A joint for tests, integrated by its own equations: J*alpha = K (phi + e) + B (dphi + de) + F_c sgn(dphi + de).

It shares no code with the product. `linear` solves a periodic motion exactly in the frequency domain, fast enough
for Monte-Carlo; `stepped` integrates with Runge-Kutta, for friction and other things that are not linear.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from edge_daemon.config.settings import ChannelSettings, Drive, Estimation
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.records import Block

FINE_HZ = 10_000.0
RATE_HZ = 1000.0


@dataclass(frozen=True)
class Joint:
    ratio: float = 100.0
    inertia: float = 0.05
    stiffness: float = 1e5
    damping: float = 20.0
    coulomb: float = 0.0
    reversal: float = 1e-3
    """twist rate [rad/s] within which the friction turns round"""
    kinematic_pp: float = math.pi / 10_800
    in_bits: int = 17
    out_bits: int = 24
    waves: tuple = ()
    """further kinematic error: (order of the motor angle, sine [rad], cosine [rad]) each"""


@dataclass(frozen=True)
class Path:
    """Output-referred input angle: multi-tone [Hz, rad/s of each] on a slow sweep; at most 3000 rpm at the motor."""

    tones: tuple = ((5.3, 0.4), (9.1, 0.4), (13.7, 0.4), (19.3, 0.4))
    sweep: tuple = (0.2, 1.2)
    seed: int = 0
    seconds: float = 30.0
    phases: tuple = field(default=())

    def angle(self, t):
        rng = np.random.default_rng(self.seed)
        total = np.zeros_like(t)
        for f_hz, speed in (*self.tones, self.sweep):
            f_hz = round(f_hz * self.seconds) / self.seconds
            w = 2 * math.pi * f_hz
            total += speed / w * np.sin(w * t + rng.uniform(0, 2 * math.pi))
        return total


def kinematic(joint, theta_in):
    """Error at the output [rad]: order 2 dominant, with 1 and 4, scaled to its peak-to-peak value."""

    def course(x):
        return np.sin(2 * x + 0.3) + 0.3 * np.sin(x + 1.0) + 0.2 * np.sin(4 * x - 0.5)

    total = joint.kinematic_pp * course(theta_in) / np.ptp(course(np.linspace(0, 2 * math.pi, 2001)))
    for order, sine, cosine in joint.waves:
        total = total + sine * np.sin(order * theta_in) + cosine * np.cos(order * theta_in)
    return total


def linear(joint, path):
    """(n,) theta_in and theta_out at RATE_HZ, true values, periodic steady state."""
    n = round(path.seconds * FINE_HZ)
    t = np.arange(n) / FINE_HZ
    out_referred = path.angle(t)
    drive = out_referred + kinematic(joint, joint.ratio * out_referred)
    w = 2 * math.pi * np.fft.rfftfreq(n, 1 / FINE_HZ)
    spring = joint.stiffness + 1j * w * joint.damping
    theta_out = np.fft.irfft(np.fft.rfft(drive) * spring / (spring - joint.inertia * w**2), n)
    every = round(FINE_HZ / RATE_HZ)
    return joint.ratio * out_referred[::every], theta_out[::every]


def stepped(joint, path, stiffness_at=None, fine_hz=FINE_HZ):
    """The same by Runge-Kutta, starting at rest on the path; `stiffness_at(t)` replaces the constant stiffness."""
    h, every = 1 / fine_hz, round(fine_hz / RATE_HZ)
    n = round(path.seconds * fine_hz)
    half = np.arange(2 * n + 2) * (h / 2)
    referred = path.angle(half)
    drive = referred + kinematic(joint, joint.ratio * referred)
    rate = np.gradient(drive, h / 2)
    u, du = drive.tolist(), rate.tolist()
    k0, b, fc, j = joint.stiffness, joint.damping, joint.coulomb, joint.inertia
    turn = 1 / joint.reversal
    x, v = u[0], du[0]
    out = np.empty(n // every)

    def force(i, x, v, k):
        d = du[i] - v
        return (k * (u[i] - x) + b * d + fc * math.tanh(d * turn)) / j

    for i in range(n):
        if i % every == 0:
            out[i // every] = x
        k = k0 if stiffness_at is None else stiffness_at(i * h)
        a1 = force(2 * i, x, v, k)
        a2 = force(2 * i + 1, x + h / 2 * v, v + h / 2 * a1, k)
        a3 = force(2 * i + 1, x + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2, k)
        a4 = force(2 * i + 2, x + h * v + h * h / 2 * a2, v + h * a3, k)
        x, v = x + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return joint.ratio * referred[:: 2 * every][: len(out)], out


def quantised(angle, bits):
    step = 2 * math.pi / 2**bits
    return np.round(angle / step) * step


def blocks(joint, theta_in, theta_out, size=100, start_s=1000.0, extra=None):
    """What the conditioning would hand over: quantised angles in blocks without flaws."""
    values = {
        "theta_in_rad": quantised(theta_in + 0.7, joint.in_bits),
        "theta_out_rad": quantised(theta_out - 0.3, joint.out_bits),
        **(extra or {}),
    }
    for i in range(len(theta_in) // size):
        part = {name: column[i * size : (i + 1) * size].copy() for name, column in values.items()}
        flaws = {name: np.zeros(size, dtype=np.uint8) for name in part}
        yield Block("joint", i, start_s + i * size / RATE_HZ, RATE_HZ, part, flaws)


def drive_settings(joint, **estimation):
    return Drive(
        name="joint",
        modbus_device_id=1,
        model="joint.toml",
        channels=(
            ChannelSettings(channel="theta_in_rad", source="can", signal="in", counts_per_turn=2**joint.in_bits),
            ChannelSettings(channel="theta_out_rad", source="can", signal="out", counts_per_turn=2**joint.out_bits),
        ),
        estimation=Estimation(**estimation),
    )


def model_of(joint, *names):
    names = names or ("linear_stiffness", "viscous_damping")
    return Model("torsion", joint.ratio, joint.inertia, tuple(ModelEffect(name) for name in names))
