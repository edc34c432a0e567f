"""What Prometheus reads, parsed by its own parser."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from edge_daemon.publish.metrics import UNIT_SUFFIXES, Metrics, metric_of
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
    assert found["strainwave_stiffness_newton_metres_per_radian", "left"] == 31_234.5
    assert found["strainwave_stiffness_newton_metres_per_radian_sd", "right"] == 12.5
    assert found["strainwave_estimate_status", "left", "stiffness"] == 0
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
    assert math.isnan(found["strainwave_damping_newton_metre_seconds_per_radian", "left"])
    assert found["strainwave_estimate_status", "left", "damping"] == 2
    assert math.isnan(found["strainwave_ratio", "left"])
    assert found["strainwave_estimate_status", "left", "ratio"] == 4


def test_a_drive_that_went_leaves_no_rows_and_there_are_no_more_rows_than_drives_times_quantities() -> None:
    metrics = Metrics()
    metrics.update(state())
    both = samples(metrics.render())
    one = samples(metrics.render(state(("left",))))
    assert sum(key[0] == "strainwave_estimate_status" for key in both) == 2 * len(QUANTITIES)
    assert not any("right" in key for key in one)


def test_before_the_first_state_only_the_process_is_known() -> None:
    assert not any(key[0].startswith("strainwave") for key in samples(Metrics().render()))


def test_every_quantity_has_a_name_of_its_own_that_ends_with_its_unit() -> None:
    named = {metric_of(row)[0] for row in QUANTITIES.values()}
    assert len(named) == len(QUANTITIES)
    assert {row.unit for row in QUANTITIES.values()} <= set(UNIT_SUFFIXES)
    assert metric_of(QUANTITIES["rul_p10_h"]) == ("strainwave_rul_p10_seconds", 3600.0)


CONFIG = Path(__file__).parents[2] / "config"


def exported() -> set[str]:
    """Names that the daemon gives, counters with their ending."""
    return {key[0] for key in samples(Metrics().render(state()))}


@pytest.mark.parametrize("file", ["grafana.json", "prometheus-alerts.yml"])
def test_what_is_shipped_for_others_names_metrics_that_there_are(file: str) -> None:
    asked = set(re.findall(r"strainwave_[a-z0-9_]+", (CONFIG / file).read_text()))
    assert len(asked) > 4 and asked <= exported()


def test_the_dashboard_is_one_that_grafana_takes() -> None:
    """Its schema: panels with a place of their own on 24 columns, a data source that is asked for, lettered targets."""
    board = json.loads((CONFIG / "grafana.json").read_text())
    assert (
        board["schemaVersion"] >= 36
        and board["uid"]
        and {row["name"] for row in board["templating"]["list"]}
        == {
            "source",
            "drive",
        }
    )
    taken: set[tuple[int, int]] = set()
    for panel in board["panels"]:
        place = panel["gridPos"]
        columns, rows = (range(place[at], place[at] + place[size]) for at, size in ("xw", "yh"))
        cells = {(x, y) for x in columns for y in rows}
        assert place["x"] + place["w"] <= 24 and not cells & taken
        taken |= cells
        assert panel["title"] and panel["datasource"]["uid"] == "${source}"
        assert [row["refId"] for row in panel["targets"]] == list("ABCDEFG"[: len(panel["targets"])])
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])


def test_the_alerts_have_what_prometheus_asks_of_a_rule() -> None:
    yaml = pytest.importorskip("yaml")
    (group,) = yaml.safe_load((CONFIG / "prometheus-alerts.yml").read_text())["groups"]
    for rule in group["rules"]:
        assert rule.keys() == {"alert", "expr", "for", "labels", "annotations"}
        assert rule["expr"].count("(") == rule["expr"].count(")") and re.fullmatch(r"\d+[smh]", rule["for"])
        assert rule["labels"]["severity"] in ("warning", "critical") and rule["annotations"]["summary"]
