"""Batches decoded by numpy equal what cantools decodes frame by frame."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import cantools
import numpy as np
import pytest

from edge_daemon.acquire.can_decode import Layout, by_key, dbc_layouts, pdo_layouts
from edge_daemon.config.settings import Pdo, SettingsError

DBC = Path(__file__).parent / "drive.dbc"
SEED = 7_051
FRAMES = 200


@pytest.mark.parametrize("layout", dbc_layouts(DBC), ids=lambda layout: layout.name)
def test_every_message_decodes_as_cantools_does(layout: Layout) -> None:
    rng = np.random.default_rng(SEED)
    payloads = [rng.bytes(layout.length) for _ in range(FRAMES)]
    if layout.name == "Switched":
        payloads = [bytes([i % 3]) + payload[1:] for i, payload in enumerate(payloads)]
    message = cantools.database.load_file(DBC).get_message_by_name(layout.name)
    expected = [message.decode(payload, decode_choices=False) for payload in payloads]
    decoded = list(layout.decode(b"".join(payloads)))
    assert {field.name for field, _, _ in decoded} == {f"{layout.name}.{s.name}" for s in message.signals}
    for field, values, mask in decoded:
        signal = field.name.split(".")[1]
        present = np.ones(FRAMES, dtype=bool) if mask is None else mask
        assert [signal in row for row in expected] == list(present)
        truth = [float(row[signal]) for row in expected if signal in row]
        np.testing.assert_array_equal(values[present], truth)


def test_a_signal_over_nine_bytes_of_a_long_frame(tmp_path: Path) -> None:
    text = 'VERSION ""\nBU_: A\nBO_ 300 Long: 24 A\n'
    text += ' SG_ L : 12|64@1- (1,0) [0|0] "" A\n SG_ B : 100|62@0+ (1,0) [0|0] "" A\n'
    (tmp_path / "long.dbc").write_text(text)
    [layout] = dbc_layouts(tmp_path / "long.dbc")
    message = cantools.database.load_file(tmp_path / "long.dbc").messages[0]
    payload = np.random.default_rng(SEED).bytes(24)
    expected = message.decode(payload)
    for field, values, _ in layout.decode(payload):
        assert values[0] == float(expected[field.name.split(".")[1]])


def test_process_data_are_read_in_the_order_of_their_mapping() -> None:
    pdo = Pdo(cob_id=0x182, node=2, objects=("statusword", "position_actual", "torque_actual"))
    [layout] = pdo_layouts([pdo])
    decoded = layout.decode(struct.pack("<Hih", 0x1237, -123_456, -17) + struct.pack("<Hih", 1, 2, 3))
    values = {field.name: list(values) for field, values, _ in decoded}
    assert values == {
        "2:statusword": [0x1237, 1],
        "2:position_actual": [-123_456, 2],
        "2:torque_actual": [-17, 3],
    }
    assert (layout.key, layout.length) == (0x182, 8)


@pytest.mark.parametrize(
    ("objects", "expected"),
    [
        (("position",), "'position' is not in the table"),
        (("position_actual", "velocity_actual", "statusword"), "80 bits: expected at most 64"),
        (("statusword", "statusword"), "expected one or more different"),
        ((), "expected one or more different"),
    ],
)
def test_wrong_process_data_are_refused(objects: tuple[str, ...], expected: str) -> None:
    with pytest.raises(SettingsError, match=expected):
        pdo_layouts([Pdo(cob_id=0x182, node=2, objects=objects)])


def test_one_identifier_cannot_mean_two_things() -> None:
    pdo = Pdo(cob_id=0x100, node=2, objects=("position_actual",))
    with pytest.raises(SettingsError, match="0x100 is claimed by EncoderIn and 2:0x100"):
        by_key([*dbc_layouts(DBC), *pdo_layouts([pdo])])


@pytest.mark.parametrize("text", ["", "\0\1\2 rubbish", "BO_ x"])
def test_what_is_no_dbc_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.dbc"
    file.write_text(text)
    try:
        layouts = dbc_layouts(file)
    except SettingsError as error:
        assert "\n" not in str(error)
        assert "bad.dbc" in str(error)
    else:
        assert not layouts
    with pytest.raises(SettingsError, match="cannot read"):
        dbc_layouts(tmp_path / "none.dbc")


def test_floats_may_be_not_a_number() -> None:
    layout = next(layout for layout in dbc_layouts(DBC) if layout.name == "Floats")
    decoded = {f.name: v[0] for f, v, _ in layout.decode(struct.pack("<f", math.nan) + struct.pack(">f", 2.5))}
    assert math.isnan(decoded["Floats.Single"])
    assert decoded["Floats.SingleBig"] == 2.5


def test_a_multiplexer_of_a_thousand_million_values_is_refused(tmp_path: Path) -> None:
    """They would be listed one by one: 32 GB of memory."""
    path = tmp_path / "wide.dbc"
    path.write_text(
        'VERSION ""\nBU_: A\nBO_ 1 Muxed: 8 A\n SG_ which M : 0|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ value m0 : 8|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 1 value which 0-3, 5-1000000000;\n'
    )
    with pytest.raises(SettingsError, match="expected a range of a multiplexer of no more than 5 digits"):
        dbc_layouts(path)
