"""`experiment` as a person types it: who consents, what is planned within the limits, and what is said."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from msgspec import structs

from edge_daemon.cli import main
from edge_daemon.commands import experiment
from edge_daemon.commands.experiment import Bench, motion_limits, profile_of, within_limits
from edge_daemon.config.reading import load
from edge_daemon.config.settings import Excite, Profile
from edge_daemon.excite.limits import PLANNED_SHARE, check_profile, most_of
from edge_daemon.excite.profiles import planned_motion
from edge_daemon.explain.plan import MENU, planned
from edge_daemon.gear.steps import remember
from edge_daemon.gear.torques import GearLaw
from edge_daemon.recordings.recording import Recording, read_recording, write_recording
from edge_daemon.rig.motion import custom
from edge_daemon.rig.plant import SUBSTEP_S
from edge_daemon.rig.recording import simulate
from edge_daemon.servo.drive import JOINT, Servo, can_hide, carried_Nm

CONFIG = Path(__file__).parents[2] / "config"


def excite_settings() -> Excite:
    it = load(CONFIG / "excite_demo.toml").drive[0].excite
    assert it is not None
    return it


def written(folder: Path, allowed: bool = True) -> Path:
    document: Any = tomlkit.parse((CONFIG / "excite_demo.toml").read_text())
    document["drive"][0]["excite"]["allowed"] = allowed
    (folder / "axis.model.toml").write_text(
        '[joint]\nbalance = "torsion"\nratio = 100.0\noutput_inertia_kg_m2 = 0.1\n'
        '[[effect]]\nname = "linear_stiffness"\n[[effect]]\nname = "viscous_damping"\n'
    )
    file = folder / "bench.toml"
    file.write_text(tomlkit.dumps(document))
    return file


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["experiment", *words]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "edge-daemon: " in line
    return line


def test_nothing_moves_without_configuration_and_a_typed_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def moved(*_: object) -> None:
        raise AssertionError("a drive was moved")

    monkeypatch.setattr(experiment, "make", moved)
    assert "allowed = true" in refused(capsys, "--config", str(written(tmp_path, allowed=False)))
    for typed in ("", "\n", "axis-2\n"):
        monkeypatch.setattr("sys.stdin", io.StringIO(typed))
        assert "not armed: expected its name typed" in refused(capsys, "--config", str(written(tmp_path)))
    assert "--most 0" in refused(capsys, "--config", str(written(tmp_path)), "--most", "0")
    assert "--seconds 2" in refused(capsys, "--config", str(written(tmp_path)), "--seconds", "2")
    assert "only with --demo" in refused(capsys, "--config", str(written(tmp_path)), "--effect", "backlash")
    assert "the simulated drive has" in refused(capsys, "--demo", "--effect", "lightning")


@pytest.mark.parametrize(
    "change",
    [{}, {"torque_Nm": 0.05}, {"travel_rad": 1.0}, {"acceleration_rad_s2": 300.0}, {"speed_rad_s": 400.0}],
)
@pytest.mark.parametrize("row", MENU)
def test_a_planned_motion_keeps_every_limit_and_is_no_smaller_than_it_must_be(
    row: Any, change: dict[str, float]
) -> None:
    it = excite_settings()
    it = structs.replace(it, limits=structs.replace(it.limits, **change))
    plan = planned(JOINT.inertia_kg_m2, JOINT.ratio, (), row, motion_limits(it, JOINT.ratio, JOINT.inertia_kg_m2))
    motion = planned_motion(within_limits(profile_of(plan, 5.0), it), it.cycle_s)
    check_profile(motion, 0.0, it.limits)
    used = max(needed / limit for _, needed, limit in most_of(motion, it.limits))
    assert 0.5 * PLANNED_SHARE < used <= PLANNED_SHARE


def test_tones_keep_their_shares() -> None:
    profile = Profile(
        name="p", kind="multi_tone", speed_rad_s=10.0, seconds=20.0, frequency_hz=(1.0, 3.0), share=(1.0, 3.0)
    )
    motion = planned_motion(profile, 0.005)
    steady = motion.phase == 2
    power = np.abs(np.fft.rfft(motion.velocity_rad_s[steady][:4000]))
    assert power[60] / power[20] == pytest.approx(3.0, rel=1e-3)


def fake_bench(monkeypatch: pytest.MonkeyPatch, ends_early_at: int = 99) -> None:
    """A drive that obeys at once: a gear with a constant load, at 1 kHz and without a torque sensor."""
    joint = {
        "inertia_kg_m2": 0.1,
        "stiffness_Nm_per_rad": 3e4,
        "damping_Nms_per_rad": 5.0,
        "constant_load.load_Nm": 1.0,
    }

    def move(self: Bench, profile: Profile) -> Recording:
        if self.made >= ends_early_at:
            raise experiment.MotionEnded("ended early: the operator let go; the drive stands")
        self.made += 1
        share = np.array(profile.share or (1.0,))
        motion = custom(profile.frequency_hz, (profile.speed_rad_s * share / share.sum()).tolist())
        made = simulate(["constant_load"], 8.1, self.made, motion=motion, parameters=joint)
        path = self.out / f"motion-{self.made}.csv"
        write_recording(path, made.time_s, made.columns)
        return read_recording(path)

    monkeypatch.setattr(Bench, "move", move)


def test_the_loop_tells_each_step_and_what_it_learned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_bench(monkeypatch)
    words = ["experiment", "--config", str(written(tmp_path)), "--out", str(tmp_path / "kept"), "--json", "-"]
    assert main(words) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert found["cause"] == "constant_load" and 1 <= len(found["motions"]) <= 3 and not found["stopped"]
    for row in found["motions"]:
        assert row["expects_bits"] is not None and row["learned_bits"] is not None and row["after"]
    for words_said in ("first look: one tone", "motion 1 of at most 3: tones from slow", "learned", "end: one cause"):
        assert words_said in said.err
    assert len(list((tmp_path / "kept").glob("motion-*.csv"))) == 1 + len(found["motions"])
    assert "holds motions already" in refused(capsys, *words[1:])


def test_a_motion_that_ends_early_ends_the_inquiry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_bench(monkeypatch, ends_early_at=1)
    assert main(["experiment", "--config", str(written(tmp_path)), "--json", str(tmp_path / "f.json")]) == 1
    assert "end: ended early: the operator let go" in capsys.readouterr().out
    found = json.loads((tmp_path / "f.json").read_text())
    assert found["stopped"] and found["motions"] == []


def flange(effect: str) -> Iterable[float]:
    """What the simulated servo's gear carries while its motor turns a little to and fro."""
    plant = Servo(0.005, 1, effect).plant
    omega, twist = 2 * np.pi / 1000, 1e-3
    for k in range(2000):
        plant.phi_rad, plant.dphi_rad_s = twist * np.sin(omega * k), twist * omega / SUBSTEP_S * np.cos(omega * k)
        for row in plant.influences:
            if row.twist:
                law = row.twist
                assert isinstance(law, GearLaw)
                remember(law.kind, law.numbers, plant.remembered(row), SUBSTEP_S, plant.dphi_rad_s)
        yield carried_Nm(plant)


def test_every_effect_that_the_simulated_servo_can_hide_is_felt_by_its_flange() -> None:
    plain = np.array([*flange("")])
    assert {"backlash", "coulomb_friction", "bouc_wen_hysteresis"} <= set(can_hide())
    for name in can_hide():
        assert np.std(np.array([*flange(name)]) - plain) > 0.01 * np.std(plain), name
