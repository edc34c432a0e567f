"""The section for test motions: what contradicts itself is named in one line."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import structs

from edge_daemon.config.contradictions import contradictions
from edge_daemon.config.settings import CanSource, ChannelSettings, Drive, Settings
from tests.excite.drive_bench import excite, sine


def problems(sync_period_s: float | None = None, **changes: Any) -> list[str]:
    bus = CanSource(name="can0", channel="can0", sync_period_s=sync_period_s)
    channel = ChannelSettings(channel="theta_in_rad", source="can0", signal="x")
    settings = structs.replace(excite(), **changes)
    return list(
        contradictions(
            Settings(
                can=(bus,),
                drive=(Drive(name="a", modbus_device_id=1, model="m", channels=(channel,), excite=settings),),
            )
        )
    )


def test_a_plain_section_is_well() -> None:
    assert problems() == []
    assert problems(0.004, sync=False) == []


@pytest.mark.parametrize(
    ("sync_period_s", "changes", "named"),
    [
        (None, {"source": "can1"}, "excite.source: 'can1' is no CAN source"),
        (0.001, {}, "excite.sync: 'can0' already produces SYNC"),
        (0.001, {"sync": False}, "excite.cycle_s: 0.004: expected the sync_period_s"),
        (None, {"profile": (sine(), sine())}, "excite.profile.name: 's' appears twice"),
    ],
)
def test_a_contradiction_is_one_line(sync_period_s: float | None, changes: dict[str, Any], named: str) -> None:
    found = problems(sync_period_s, **changes)
    assert len(found) == 1 and named in found[0]
