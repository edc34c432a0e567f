"""An encoder that fails is told by its own samples, and a hard motion is no encoder's fault."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.condition.scatter import GIVES_IN_S, ScatterWatch
from edge_daemon.records import Block

RATIO, RATE_HZ, SIZE = 100.0, 1000.0, 300
STEP_IN, STEP_OUT = 2 * math.pi / 2**17, 2 * math.pi / 2**24
MOTOR, OUT = "theta_in_rad", "theta_out_rad"


class Drive:
    """Angles of a rigid gear, read in whole steps."""

    def __init__(self) -> None:
        self.rng, self.at = np.random.default_rng(2), 0
        rounding_rad = {MOTOR: STEP_IN / math.sqrt(12), OUT: STEP_OUT / math.sqrt(12)}
        self.watch = ScatterWatch({MOTOR: RATIO, OUT: 1.0}, rounding_rad)
        self.failure = ""

    def see(self, shaken_rad: float = 0.0, noise_steps: float = 0.0, jump_rad: float = 0.0) -> None:
        """A block: the output shaken by the motor, noise of the output's encoder, and a jump of it in mid-block."""
        time_s = (self.at + np.arange(SIZE)) / RATE_HZ
        self.at += SIZE
        out = 0.5 * np.sin(2 * math.pi * 0.7 * time_s) + shaken_rad * self.rng.normal(size=SIZE)
        read = out + jump_rad * (np.arange(SIZE) > SIZE / 2) + noise_steps * STEP_OUT * self.rng.normal(size=SIZE)
        values = {MOTOR: np.rint(RATIO * out / STEP_IN) * STEP_IN, OUT: np.rint(read / STEP_OUT) * STEP_OUT}
        flaws = {name: np.zeros(SIZE, dtype=np.uint8) for name in values}
        self.failure = self.watch.see(Block("axis", self.at, float(time_s[0]), RATE_HZ, values, flaws))

    @classmethod
    def known(cls) -> Drive:
        """One that has moved for a while."""
        drive = cls()
        for _ in range(30):
            drive.see()
        assert not drive.failure
        return drive


def test_the_encoder_that_scatters_is_named_at_once_and_only_while_it_does() -> None:
    drive = Drive.known()
    drive.see(noise_steps=8.0)
    assert drive.failure.startswith(OUT)
    drive.see()
    assert not drive.failure


def test_what_shakes_both_angles_alike_is_the_motion() -> None:
    drive = Drive.known()
    for _ in range(5):
        drive.see(shaken_rad=30 * STEP_IN / RATIO)
        assert not drive.failure


def test_a_slip_is_no_encoder_that_fails_again_and_again() -> None:
    drive = Drive.known()
    for jump_rad in (1e-2, 0.0, 0.0, 1e-2, 0.0, 0.0):
        drive.see(jump_rad=jump_rad)
        assert not drive.failure


def test_noise_that_stays_is_taken_for_what_it_is() -> None:
    drive = Drive.known()
    blocks = math.ceil(GIVES_IN_S * RATE_HZ / SIZE)
    for _ in range(blocks):
        drive.see(noise_steps=8.0)
        assert drive.failure
    for _ in range(3):
        drive.see(noise_steps=8.0)
    assert not drive.failure
