"""Every profile against calculus: it starts and ends at rest, and its derivatives are its own."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.config.settings import Profile
from edge_daemon.excite.profiles import ProfileError, planned_motion

PROFILES = [
    Profile(name="a", kind="sine", speed_rad_s=50, seconds=2, frequency_hz=(3.0,), fade_s=0.5),
    Profile(name="b", kind="multi_tone", speed_rad_s=50, seconds=2, frequency_hz=(1.1, 3.7, 9.3), fade_s=0.5),
    Profile(name="c", kind="chirp", speed_rad_s=50, seconds=3, frequency_hz=(1.0, 20.0), fade_s=0.5),
    Profile(name="d", kind="steps", speed_rad_s=20, travel_rad=6.0, repeats=2, dwell_s=0.3, fade_s=0.2),
    Profile(name="e", kind="slow_reversal", speed_rad_s=5, travel_rad=8.0, repeats=2, fade_s=0.4),
]


@pytest.mark.parametrize("profile", PROFILES, ids=lambda p: p.kind)
def test_derivatives_speed_and_rest(profile: Profile) -> None:
    step = 1e-3
    it = planned_motion(profile, step)
    assert len({len(it.position_rad), len(it.velocity_rad_s), len(it.acceleration_rad_s2), len(it.phase)}) == 1
    inner = slice(1, -1)
    speed = (it.position_rad[2:] - it.position_rad[:-2]) / (2 * step)
    acceleration = (it.velocity_rad_s[2:] - it.velocity_rad_s[:-2]) / (2 * step)
    fastest, hardest = np.abs(it.velocity_rad_s).max(), np.abs(it.acceleration_rad_s2).max()
    assert np.abs(speed - it.velocity_rad_s[inner]).max() < 3e-3 * fastest
    assert np.abs(acceleration - it.acceleration_rad_s2[inner]).max() < 5e-3 * hardest
    assert fastest == pytest.approx(profile.speed_rad_s, rel=0.01)
    for end in (0, -1):
        assert abs(it.position_rad[end]) < 1e-7
        assert abs(it.velocity_rad_s[end]) < 1e-3 * fastest
        assert abs(it.acceleration_rad_s2[end]) < 0.02 * hardest
    assert it.phase[0] == it.phase[-1] == 0 and it.phase.max() < len(it.parts)


def test_phases_say_where_the_motor_rests() -> None:
    it = planned_motion(PROFILES[3], 1e-3)
    dwells = [i for i, name in enumerate(it.parts) if name.startswith("dwell")]
    assert len(dwells) == 8  # two up, four down, two up
    resting = np.isin(it.phase, dwells)
    assert np.abs(it.velocity_rad_s[resting]).max() == 0
    levels = sorted({round(float(x), 6) for x in it.position_rad[resting]})
    assert levels == [-12.0, -6.0, 0.0, 6.0, 12.0]


def test_slow_reversal_marks_its_direction() -> None:
    it = planned_motion(PROFILES[4], 1e-3)
    for mark, sign in ((1, 1.0), (2, -1.0)):
        assert (it.velocity_rad_s[it.phase == mark] * sign > -1e-9).all()
    assert np.ptp(it.position_rad) == pytest.approx(8.0, rel=1e-6)


def test_chirp_sweeps_its_band() -> None:
    it = planned_motion(PROFILES[2], 1e-3)
    crossings = np.nonzero(np.diff(np.signbit(it.velocity_rad_s)))[0]
    periods = 2 * np.diff(crossings) * 1e-3
    assert 1 / periods[0] < 2 and 1 / periods[-1] > 15


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"kind": "sine"}, "frequency_hz"),
        ({"kind": "sine", "frequency_hz": (200.0,)}, "frequency_hz"),
        ({"kind": "chirp", "frequency_hz": (1.0,)}, "frequency_hz"),
        ({"kind": "steps"}, "travel_rad"),
    ],
)
def test_a_missing_figure_is_named(changes: dict[str, object], key: str) -> None:
    with pytest.raises(ProfileError, match=key):
        planned_motion(Profile(name="x", speed_rad_s=1.0, **changes), 0.004)  # type: ignore[arg-type]
