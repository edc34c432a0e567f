"""The Modbus map: its shape, its documents, and what a drive's state looks like in it."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import struct
import tomllib
from pathlib import Path

import pytest

from edge_daemon.publish.registers import (
    BLOCKS,
    BY_NAME,
    CAPACITY,
    FIRST,
    LENGTH,
    PLACES,
    READS,
    REGISTERS,
    STATES,
    STATUS_CODES,
    STRIDE,
    TOTAL,
    block_and_bit,
    in_block,
    named,
    render,
)
from edge_daemon.publish.words import encode
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import NE107, Estimate, Snapshot, Status

NOW_S = 1_700_000_010.0


def snapshot(*estimates: Estimate, time_s: float = NOW_S - 0.25, state: NE107 = NE107.OK) -> Snapshot:
    return Snapshot("joint", 7, time_s, state, (), {row.name: row for row in estimates})


def estimate(name: str, value: float, sd: float = 1.0, status: Status = Status.VALID) -> Estimate:
    return Estimate(name, value, sd, QUANTITIES[name].unit, status, NOW_S - 3.0)


def words(state: Snapshot | None, *, now_s: float = NOW_S, word_order: str = "big") -> list[int]:
    return encode(state, now_s=now_s, sequence=70_000, heartbeat=65_537, stale_after_s=5.0, word_order=word_order)  # type: ignore[arg-type]


def f32(block: list[int], name: str) -> float:
    at = BY_NAME[name].address
    return float(struct.unpack(">f", struct.pack(">HH", *block[at : at + 2]))[0])


def u32(block: list[int], name: str) -> int:
    at = BY_NAME[name].address
    return block[at] << 16 | block[at + 1]


def u16(block: list[int], name: str) -> int:
    return block[BY_NAME[name].address]


def test_every_quantity_has_its_place() -> None:
    assert set(PLACES) == set(QUANTITIES), "append the new quantity to registers.PLACES and raise MAP_VERSION"
    assert all(len(in_block(block)) <= CAPACITY for block in range(BLOCKS))
    assert [(address % LENGTH - FIRST) % STRIDE for address in PLACES.values()] == [0] * len(PLACES)
    assert [*PLACES.values()] == sorted(set(PLACES.values())), "appended, not put between"


SHIPPED_HEAD = {
    "marker": 0, "map_version": 1, "sequence": 2, "heartbeat": 4, "state": 5, "data_age_ms": 6, "test_float": 8,
    "data_time_s": 10, "usable_0": 12, "block_length": 15, "not_usable_0": 16, "quantities": 19, "not_excited_0": 20,
    "stiffness_sd": 60, "stiffness_status": 62, "stiffness_age_s": 63, "sequence_end": 246,
}  # fmt: skip
SHIPPED_QUANTITIES = (
    "health_index", "damage", "rul_p10_h", "rul_p50_h", "rul_p90_h", "stiffness", "damping", "coulomb_friction",
    "kinematic_error", "stiffness_change", "noise_a0", "noise_a1", "noise_a2", "noise_a3", "noise_a4", "noise_rms",
    "ratio", "ratcheting_events", "torque_rms", "torque_peak", "torque_cubic_mean", "speed_in", "temperature",
    "pressure", "model_nrmse", "model_noise_floor", "model_rmse", "encoder_skew", "sound_angle_sd",
    "sound_angle_slips", "stribeck_speed", "hysteresis_width", "hysteresis_state", "half_gap",
)  # fmt: skip
"""In the order of their addresses, from 28 on, 6 registers each."""


def test_addresses_that_were_shipped_stay_where_plc_programs_expect_them() -> None:
    """Written down a second time on purpose."""
    shipped = SHIPPED_HEAD | {name: 28 + 6 * n for n, name in enumerate(SHIPPED_QUANTITIES)}
    assert {name: BY_NAME[name].address for name in shipped} == shipped


def test_the_second_block_has_the_shape_of_the_first() -> None:
    """A program that reads one of them reads the other with another start."""
    heads = [row for row in REGISTERS if row.address < FIRST or row.name == "sequence_end"]
    for row in heads:
        name = (
            re.sub(r"(_\d)?$", r"_block2\1", row.name, count=1)
            if "usable" in row.name or "excited" in row.name
            else named(row.name, 1)
        )
        assert (BY_NAME[name].address, BY_NAME[name].type) == (row.address + LENGTH, row.type)
    block = words(snapshot(estimate("stiffness", 2.0)))
    of_block = len(in_block(1))
    assert (u16(block, "marker_block2"), u16(block, "block_length_block2")) == (0x5357, LENGTH)
    assert (u16(block, "quantities"), u16(block, "quantities_block2")) == (len(PLACES) - of_block, of_block)
    assert u32(block, "sequence_block2") == u32(block, "sequence_end_block2") == 70_000
    assert f32(block, "test_float_block2") == 12345.0


def test_a_quantity_of_the_second_block_has_its_bit_there() -> None:
    name = in_block(1)[-1]
    block = words(snapshot(estimate(name, 7.5)))
    _, number = block_and_bit(PLACES[name])
    assert f32(block, name) == 7.5
    assert u16(block, f"usable_block2_{number // 16}") == 1 << number % 16
    assert not u16(block, f"usable_{number // 16}")


def test_registers_neither_overlap_nor_straddle_a_read_and_32_bit_values_are_on_even_addresses() -> None:
    taken = [address for row in REGISTERS for address in range(row.address, row.address + row.words)]
    assert len(taken) == len(set(taken))
    assert max(taken) == TOTAL - 1
    assert sum(count for _, count in READS) == TOTAL and all(count <= 125 for _, count in READS)
    for row in REGISTERS:
        if row.words == 2:
            assert row.address % 2 == 0, row
            assert any(first <= row.address and row.address + 2 <= first + count for first, count in READS), row
    assert [row.address for row in REGISTERS] == sorted(row.address for row in REGISTERS)


def test_numbers_arrive_as_they_were_estimated() -> None:
    block = words(snapshot(estimate("stiffness", 31_234.5, 12.25), estimate("ratio", 100.0, 0.0)))
    assert f32(block, "stiffness") == 31_234.5
    assert f32(block, "stiffness_sd") == 12.25
    assert u16(block, "stiffness_status") == STATUS_CODES["valid"]
    assert u16(block, "stiffness_age_s") == 3
    assert (f32(block, "ratio"), f32(block, "ratio_sd")) == (100.0, 0.0)
    assert f32(block, "test_float") == 12345.0
    assert (u32(block, "sequence"), u32(block, "sequence_end"), u16(block, "heartbeat")) == (70_000, 70_000, 1)
    assert u32(block, "data_age_ms") == 250
    assert u32(block, "data_time_s") == 1_700_000_009
    assert u16(block, "state") == NE107.OK


def test_little_word_order_swaps_the_words_of_32_bit_values_only() -> None:
    state = snapshot(estimate("stiffness", 31_234.5))
    big, little = words(state), words(state, word_order="little")
    for row in REGISTERS:
        mine = big[row.address : row.address + row.words]
        assert little[row.address : row.address + row.words] == mine[::-1], row


@pytest.mark.parametrize(
    ("given", "code"),
    [
        (estimate("stiffness", 1.0, status=Status.WARMING_UP), "warming_up"),
        (estimate("stiffness", 1.0, status=Status.INVALID), "invalid"),
        (estimate("stiffness", math.nan), "invalid"),
        (estimate("stiffness", math.inf), "invalid"),
        (estimate("stiffness", 1.0, sd=math.nan), "invalid"),
        (estimate("stiffness", 1e39), "invalid"),
        (estimate("stiffness", 1.0, sd=1e39), "invalid"),
        (estimate("damping", 1.0), "unknown"),
    ],
)
def test_what_is_not_usable_reads_nan_with_its_status(given: Estimate, code: str) -> None:
    block = words(snapshot(given))
    assert math.isnan(f32(block, "stiffness")) and math.isnan(f32(block, "stiffness_sd"))
    assert u16(block, "stiffness_status") == STATUS_CODES[code]
    _, number = block_and_bit(PLACES["stiffness"])
    assert not u16(block, "usable_0") >> number & 1
    assert u16(block, "not_usable_0") >> number & 1


def test_a_value_that_the_motion_does_not_excite_keeps_its_number_and_says_so() -> None:
    block = words(snapshot(estimate("model_rmse", 2.0, status=Status.NOT_EXCITED)))
    _, number = block_and_bit(PLACES["model_rmse"])
    assert f32(block, "model_rmse") == 2.0
    assert u16(block, "model_rmse_status") == STATUS_CODES["not_excited"]
    assert u16(block, f"usable_{number // 16}") == 1 << number % 16
    assert u16(block, f"not_excited_{number // 16}") == 1 << number % 16


def test_stale_data_reads_nan_never_the_last_good_number() -> None:
    state = snapshot(*(estimate(name, 1.0) for name in QUANTITIES))
    fresh, stale = words(state), words(state, now_s=NOW_S + 4.8)
    assert all(f32(fresh, name) == 1.0 for name in QUANTITIES)
    assert all(math.isnan(f32(stale, name)) and math.isnan(f32(stale, f"{name}_sd")) for name in QUANTITIES)
    assert all(u16(stale, f"{name}_status") == STATUS_CODES["stale"] for name in QUANTITIES)
    assert u16(stale, "state") == NE107.FAILURE
    assert [u16(stale, f"usable_{word}") for word in range(3)] == [0, 0, 0]
    assert u32(stale, "data_age_ms") == 5050


@pytest.mark.parametrize("state", [None, snapshot(time_s=math.nan)])
def test_before_the_first_data_nothing_is_known(state: Snapshot | None) -> None:
    block = words(state)
    assert u32(block, "data_age_ms") == 0xFFFF_FFFF
    assert u32(block, "data_time_s") == 0
    assert u16(block, "state") == NE107.FUNCTION_CHECK
    assert all(u16(block, f"{name}_status") == STATUS_CODES["unknown"] for name in QUANTITIES)


def test_a_clock_that_stepped_back_gives_age_zero_not_a_huge_one() -> None:
    assert u32(words(snapshot(time_s=NOW_S + 60.0)), "data_age_ms") == 0


def test_the_document_in_config_is_the_generated_one() -> None:
    document = Path(__file__).parents[2] / "config" / "registers.md"
    assert document.read_text() == render("md"), "run: edge-daemon registers > config/registers.md"


def test_csv_has_the_agreed_columns_and_every_register() -> None:
    text = render("csv")
    assert text.splitlines()[0] == "name,address,type,unit,meaning"
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [(row["name"], int(row["address"]), row["type"]) for row in rows] == [
        (row.name, row.address, row.type) for row in REGISTERS
    ]


def test_json_lists_every_register() -> None:
    document = json.loads(render("json"))
    assert document["length"] == TOTAL
    assert {row["name"]: row["address"] for row in document["registers"]} == {r.name: r.address for r in REGISTERS}


def test_telegraf_reads_every_value_at_its_address() -> None:
    (plugin,) = tomllib.loads(render("telegraf"))["inputs"]["modbus"]
    types = {"u16": "UINT16", "u32": "UINT32", "f32": "FLOAT32"}
    rows = {row["name"]: (row["address"], row["data_type"]) for row in plugin["input_registers"]}
    assert rows == {row.name: (list(range(row.address, row.address + row.words)), types[row.type]) for row in REGISTERS}
    assert plugin["controller"] == "tcp://127.0.0.1:5020"


def test_home_assistant_reads_what_a_home_can_use_at_its_address() -> None:
    yaml = pytest.importorskip("yaml")
    (hub,) = yaml.safe_load(render("homeassistant"))["modbus"]
    types = {"u16": "uint16", "u32": "uint32", "f32": "float32"}
    assert {row["name"]: (row["address"], row["data_type"]) for row in hub["sensors"]} == {
        row.name: (row.address, types[row.type]) for row in REGISTERS if row.name in {*QUANTITIES, *STATES}
    }
    assert len({row["unique_id"] for row in hub["sensors"]}) == len(QUANTITIES) + len(STATES)
    known = {row["name"]: row for row in hub["sensors"]}
    assert known["temperature"]["unit_of_measurement"] == "°C" and known["temperature"]["device_class"] == "temperature"
    assert known["turns_in"]["state_class"] == "total_increasing" and "device_class" not in known["stiffness"]
    assert {row["unit_of_measurement"] for row in hub["sensors"] if row["name"] == "stiffness"} == {"N m/rad"}


def test_an_unknown_format_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="'xml': expected one of md, csv, json, telegraf, homeassistant"):
        render("xml")


def test_home_assistant_rounds_nothing_to_zero_that_a_gear_can_have() -> None:
    """Smallest numbers of the simulated gear that mean something: half a microsecond, 1e-9 of a sensor unit squared."""
    smallest = {"encoder_skew": 5e-7, "noise_a4": 4e-9, "kinematic_error": 1e-5, "damage": 1e-6, "stiffness": 1e3}
    yaml = pytest.importorskip("yaml")
    (hub,) = yaml.safe_load(render("homeassistant"))["modbus"]
    decimals = {row["name"]: row.get("precision") for row in hub["sensors"]}
    for name, value in smallest.items():
        assert float(f"{value:.{decimals[name]}f}") == pytest.approx(value, rel=0.01)
