"""One encoder and the motor's torque, followed live, against joints that share nothing with the product."""

import math
from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.config.settings import ChannelSettings, Drive
from edge_daemon.effects.effect import Wave
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect
from edge_daemon.records import Block, Status
from edge_daemon.track.live import DriveEstimator
from edge_daemon.track.orders import orders_of
from tests.explain.elastic_joint import ElasticArm
from tests.explain.elastic_joint import record as swinging
from tests.explain.one_encoder import carried
from tests.explain.simulated_drives import PLAIN_SENSING, RATIO, Arm, Sensing, record

PLAIN = ("inertia", "viscous_friction", "coulomb_friction", "gravity_load")
LOADED = (*PLAIN, "load_dependent_friction")
ARM = Arm(weight_Nm=12.0)
TRUTH = {
    ("inertia", "inertia"): ARM.inertia_kg_m2 / RATIO,
    ("viscous_friction", "coefficient"): ARM.viscous_Nms / RATIO,
    ("coulomb_friction", "friction"): ARM.coulomb_Nm / RATIO,
    ("gravity_load", "sine"): ARM.weight_Nm / RATIO,
}


QUIET, NOISY = Sensing(rate_hz=1000.0), Sensing(rate_hz=500.0, noise=0.05)


def follow(arm, names, seed, sensing=QUIET, estimator=None, upto=1.0, more=None, turns=1):
    """The estimator after a recording, or after a part of it, with `more` torque of that; the output `turns` with the
    motor, or against it."""
    made = swinging if isinstance(arm, ElasticArm) else record
    joint, block = made(arm, seed, 30.0, sensing), round(sensing.rate_hz / 10)
    if more:
        joint.columns["torque_in_Nm"] = joint.columns["torque_in_Nm"] + more(joint)
    columns = {name: joint.columns[name] for name in ("theta_out_rad", "torque_in_Nm", "temperature_degC")}
    columns["torque_in_Nm"] = turns * columns["torque_in_Nm"]
    channels = tuple(ChannelSettings(channel=name, source="can", signal=name) for name in columns)
    drive = Drive(name="joint", modbus_device_id=1, model="m.toml", rate_hz=sensing.rate_hz, channels=channels)
    estimator = estimator or DriveEstimator(
        drive,
        Model(
            "drive", turns * RATIO, math.nan, tuple(ModelEffect(row) if isinstance(row, str) else row for row in names)
        ),
    )
    for i in range(round(upto * len(joint.time_s)) // block):
        values = {name: column[i * block : (i + 1) * block] for name, column in columns.items()}
        flaws = {name: np.zeros(block, np.uint8) for name in values}
        estimator.update(Block("joint", i, i * block / sensing.rate_hz, sensing.rate_hz, values, flaws))
    return estimator


def told(estimator, truth=TRUTH):
    """Each amplitude as an estimate, with what it truly is."""
    return [(estimator.tracker.estimate(key[0], "", key), value) for key, value in truth.items()]


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("sensing", [QUIET, NOISY], ids=["quiet", "noisy"])
@pytest.mark.parametrize("mesh", [0.0, 0.1])
def test_amplitudes_are_right_within_a_deviation_that_tells_something(mesh, sensing, seed):
    arm, names = Arm(weight_Nm=12.0, mesh=mesh), LOADED if mesh else PLAIN
    truth = {**TRUTH, ("load_dependent_friction", "coefficient"): mesh} if mesh else TRUTH
    estimator = follow(arm, names, seed, sensing)
    for estimate, value in told(estimator, truth):
        assert estimate.status is Status.VALID
        assert abs(estimate.value - value) < 3 * estimate.sd
        assert estimate.sd < 0.05 * value
    assert estimator.tracker.restarts == 0


def test_bristles_under_a_load_are_followed():
    """Load friction leapt beside them while they still bent, and their level was told three deviations too high."""
    bent = {name: FittedParameter(value, 0.0) for name, value in (("width", 2e-3), ("static_ratio", 1.0))}
    names = (*PLAIN[:2], "gravity_load", ModelEffect("lugre_friction", bent), "load_dependent_friction")
    arm = Arm(weight_Nm=40.0, coulomb_Nm=5.0, mesh=0.08, bristles=(2500.0, 40.0))
    sizes = {("lugre_friction", "friction"): 5.0 / RATIO, ("load_dependent_friction", "coefficient"): 0.08}
    for estimate, value in told(follow(arm, names, 1), sizes):
        assert abs(estimate.value - value) < 2 * estimate.sd
        assert estimate.sd < 0.05 * value


def test_a_motor_that_turns_against_the_output_is_followed_by_its_own_torque():
    """A flexspline turns against its wave generator: the ratio is below 0, and the motor's torque is its own."""
    with_it, against = (follow(ARM, PLAIN, 1, turns=turns) for turns in (1, -1))
    for one, other in zip(told(with_it), told(against), strict=True):
        assert other[0].value == pytest.approx(one[0].value, rel=1e-9)
        assert other[0].status is Status.VALID


@pytest.mark.parametrize("arm", [Arm(weight_Nm=12.0, mesh=0.1), Arm(weight_Nm=12.0, stribeck_Nm=2.5)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_a_model_lacks_is_in_the_doubt(arm, seed):
    for estimate, value in told(follow(arm, PLAIN, seed)):
        assert abs(estimate.value - value) < 4 * estimate.sd


SLIDING = Arm(weight_Nm=12.0, coulomb_Nm=4.0, bristle_rad=(5e-4, 1.5e-3, 4.5e-3, 1.35e-2))
WIDTH = {"width": FittedParameter(5e-4, 5e-6, "rad", True)}
CREEP = {"stribeck_speed": FittedParameter(0.1, 1e-3, "rad/s", True)}


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("arm", "rubs", "key"),
    [
        (
            replace(SLIDING, mesh=0.2),
            ModelEffect("load_dependent_friction"),
            ("load_dependent_friction", "coefficient"),
        ),
        (replace(SLIDING, stribeck_Nm=3.0), ModelEffect("stribeck_friction", CREEP), ("stribeck_friction", "excess")),
    ],
    ids=["of the load", "at creep"],
)
def test_friction_that_builds_up_is_told_beside_presliding(arm, rubs, key, seed) -> None:
    """With the sign of the speed friction of the load was six deviations too little. What friction has more at creep
    showed nothing in a first stretch at speed, whose prior was without end, and the estimator fell over it."""
    names = (*(row for row in PLAIN if row != "coulomb_friction"), ModelEffect("maxwell_slip_hysteresis", WIDTH), rubs)
    truth = {row: value for row, value in TRUTH.items() if row[0] != "coulomb_friction"}
    value = arm.mesh or arm.stribeck_Nm / RATIO
    for estimate, true in told(follow(arm, names, seed), {**truth, key: value}):
        assert estimate.status is Status.VALID
        assert abs(estimate.value - true) < 3 * estimate.sd
        assert estimate.sd < 1.5 * true


@pytest.mark.parametrize("share", [0.5, None])
def test_an_error_of_the_transmission_is_followed_where_its_share_is_known(share) -> None:
    """Around another share than the joint has it is surely nothing, so that without one nothing is valid."""
    arm = Arm(weight_Nm=12.0, rotor=0.5 if share else 0.0, error=(2.0, 2e-5, 0.4))
    known = {"share": FittedParameter(share, 0.01, "1", True)} if share else {}
    effects = (*map(ModelEffect, PLAIN), ModelEffect("kinematic_error", known))
    waves = {("kinematic_error", f"{word}_2"): 2e-5 * f(0.4) for word, f in (("sine", math.cos), ("cosine", math.sin))}
    for estimate, value in told(follow(arm, effects, 1), waves):
        assert (estimate.status is Status.VALID) is bool(share)
        assert not share or abs(estimate.value - value) < 0.05 * abs(value)


@pytest.mark.parametrize("more", [(), ("constant_torque",)])
@pytest.mark.parametrize("sensing", [QUIET, NOISY], ids=["quiet", "noisy"])
def test_a_steady_load_is_followed_where_nothing_else_is_steady(sensing, more) -> None:
    """Beside a constant torque the two are one until friction of the load is known: then neither is said."""
    arm = Arm(steady_Nm=4.0, mesh=0.1, coulomb_Nm=3.0)
    names = ("inertia", "viscous_friction", "coulomb_friction", "load_dependent_friction", "constant_load", *more)
    truth = {("constant_load", "load"): 4.0 / RATIO, ("load_dependent_friction", "coefficient"): 0.1}
    for estimate, value in told(follow(arm, names, 1, sensing), truth):
        assert (estimate.status is Status.VALID) is not bool(more)
        assert more or abs(estimate.value - value) < 3 * estimate.sd < 0.1 * value


@pytest.mark.parametrize("sensing", [QUIET, Sensing(rate_hz=500.0, bits=18, noise=0.05)], ids=["quiet", "noisy"])
def test_a_load_that_swings_on_the_spring_is_followed_at_its_frequency(sensing) -> None:
    """Its column goes on from block to block, and is not believed where it is noise."""
    arm = ElasticArm()
    swing = {"frequency": (arm.swing_hz, "Hz"), "damping": (arm.damping, "1")}
    known = {name: FittedParameter(value, 0.01 * value, unit, True) for name, (value, unit) in swing.items()}
    ripple = ModelEffect("wave_generator_ripple", waves=(Wave("input", 2.0),))
    effects = (*map(ModelEffect, PLAIN), ModelEffect("joint_elasticity", known), ripple)
    whole = {**TRUTH, ("joint_elasticity", "inertia"): arm.load_kg_m2 / RATIO}
    for estimate, value in told(follow(arm, effects, 1, sensing), whole):
        assert abs(estimate.value - value) < max(4 * estimate.sd, 0.03 * value)
        assert sensing is not QUIET or (estimate.status is Status.VALID and estimate.sd < 0.1 * value)


@pytest.mark.parametrize("effect", ["wave_generator_ripple", "load_ripple"])
def test_the_size_of_a_wave_is_that_of_its_largest_form(effect) -> None:
    """Ripple that turns with the motion, or with the load, was published as nothing."""
    size = {"wave_generator_ripple": 0.6 / RATIO, "load_ripple": 0.06}[effect]

    def more(joint):
        speed, load = carried(joint, replace(ARM, rotor=0.0))
        signed = np.sign(speed) if effect == "wave_generator_ripple" else load / RATIO
        return size * signed * np.sin(2 * RATIO * joint.columns["theta_out_rad"] + 0.4)

    ripple = ModelEffect(effect, waves=(Wave("input", 2.0),))
    estimator = follow(ARM, (*map(ModelEffect, PLAIN), ripple), 1, PLAIN_SENSING, more=more)
    found = {row.estimate.name: row.estimate for row in orders_of(estimator.tracker)}[f"{effect}_2"]
    assert found.value == pytest.approx(size, rel=0.05) and found.sd < 0.2 * size


def test_a_restart_goes_on_with_the_load_that_it_knew():
    arm = Arm(weight_Nm=12.0, mesh=0.1)
    before = follow(arm, LOADED, 1)
    after = DriveEstimator(before.drive, before.model)
    assert after.restore(before.state())
    follow(arm, LOADED, 1, estimator=after, upto=0.2)
    for (estimate, _), (known, _) in zip(told(after), told(before), strict=True):
        assert estimate.status is Status.VALID
        assert abs(estimate.value - known.value) < 3 * known.sd


def test_what_the_motion_never_showed_is_not_known():
    """A load that nothing tells: neither inertia nor weight is in the model."""
    estimator = follow(ARM, ("viscous_friction", "coulomb_friction", "load_dependent_friction"), 1, upto=0.7)
    estimate = estimator.tracker.estimate("", "", ("load_dependent_friction", "coefficient"))
    assert estimate.status is not Status.VALID
