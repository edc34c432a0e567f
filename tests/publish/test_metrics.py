"""What Prometheus reads, parsed by its own parser."""

from __future__ import annotations

import math

from prometheus_client.parser import text_string_to_metric_families

from edge_daemon.publish.metrics import Metrics
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import NE107, Estimate, GatewayState, LinkHealth, Snapshot, SourceHealth, Status
from edge_daemon.service.supervisor import TaskHealth


def state(drives: tuple[str, ...] = ("left", "right")) -> GatewayState:
    rows = {
        "stiffness": Estimate("stiffness", 31_234.5, 12.5, "N m/rad", Status.VALID, 90.0),
        "damping": Estimate("damping", 3.0, 1.0, "N m s/rad", Status.WARMING_UP, 90.0),
    }
    return GatewayState(
        site="hall-2", gateway='gw"1', version="0.1.0", started_s=10.0, now_s=100.0,
        snapshots={name: Snapshot(name, 42, 99.5, NE107.MAINTENANCE_REQUIRED, ("worn",), rows) for name in drives},
        sources=(SourceHealth("can0", "degraded", "bus off", 99.0, {"readings": 1000, "errors": 3}),),
        tasks=(TaskHealth("drive left", "waiting", 4, "boom"),),
        events=(),
        links=(LinkHealth("zenoh", "ok", "", {"dropped": 7.0, "queued": 2.0}),),
    )  # fmt: skip


def samples(text: bytes) -> dict[tuple[str, ...], float]:
    """(name, label values in the order of their names) -> value"""
    return {
        (row.name, *(value for _, value in sorted(row.labels.items()))): row.value
        for family in text_string_to_metric_families(text.decode())
        for row in family.samples
    }


def test_numbers_states_and_counters_arrive() -> None:
    found = samples(Metrics().render(state()))
    assert found["strainwave_estimate", "left", "stiffness", "N m/rad"] == 31_234.5
    assert found["strainwave_estimate_sd", "right", "stiffness", "N m/rad"] == 12.5
    assert found["strainwave_estimate_status", "left", "stiffness", "N m/rad"] == 0
    assert found["strainwave_drive_state", "left"] == 1
    assert found["strainwave_data_age_seconds", "left"] == 0.5
    assert found["strainwave_blocks_total", "left"] == 42
    assert found["strainwave_source_events_total", "errors", "can0"] == 3
    assert found["strainwave_source_state", "can0"] == 2
    assert found["strainwave_task_restarts_total", "drive left"] == 4
    assert found["strainwave_task_running", "drive left"] == 0
    assert found["strainwave_link_figure", "dropped", "zenoh"] == 7
    assert found["strainwave_up_seconds",] == 90.0
    assert found["process_resident_memory_bytes",] > 1e6


def test_what_is_not_usable_is_nan_with_its_status() -> None:
    found = samples(Metrics().render(state()))
    assert math.isnan(found["strainwave_estimate", "left", "damping", "N m s/rad"])
    assert found["strainwave_estimate_status", "left", "damping", "N m s/rad"] == 2
    assert math.isnan(found["strainwave_estimate", "left", "ratio", "1"])
    assert found["strainwave_estimate_status", "left", "ratio", "1"] == 4


def test_a_drive_that_went_leaves_no_rows_and_there_are_no_more_rows_than_drives_times_quantities() -> None:
    metrics = Metrics()
    metrics.update(state())
    both = samples(metrics.render())
    one = samples(metrics.render(state(("left",))))
    assert sum(key[0] == "strainwave_estimate" for key in both) == 2 * len(QUANTITIES)
    assert not any("right" in key for key in one)


def test_before_the_first_state_only_the_process_is_known() -> None:
    assert not any(key[0].startswith("strainwave") for key in samples(Metrics().render()))
