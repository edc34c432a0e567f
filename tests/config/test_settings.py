"""Every mistake in a configuration gives one line: file, where, what, what was expected."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from edge_daemon.config.reading import load
from edge_daemon.config.settings import SettingsError
from edge_daemon.errors import BadInput
from edge_daemon.service.configuration import examined

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "config" / "axis.model.toml"
GOOD = """
[[can]]
name = "can0"
channel = "can0"

[[drive]]
name = "axis-1"
modbus_device_id = 1
model = "axis.model.toml"

[[drive.channels]]
channel = "theta_in_rad"
source = "can0"
signal = "In.position"
counts_per_turn = 131072
"""


def sensor(*addresses: str) -> str:
    """A Modbus sensor on a serial line with a read at each address, and the drives' header again."""
    reads = ", ".join(f"{{signal = 's{j}', address = {address}}}" for j, address in enumerate(addresses))
    return f"[[modbus]]\nname = 'air'\ntransport = 'rtu'\nserial = '/dev/ttyUSB0'\nreads = [{reads}]\n[[drive]]"


def bus(*addresses: str) -> str:
    """An I2C bus with a part at each address, and the drives' header again."""
    parts = ", ".join(f"{{name = 'd{j}', address = {a}, preset = 'bmp280'}}" for j, a in enumerate(addresses))
    return f"[[i2c]]\nname = 'housing'\nbus = 1\ndevices = [{parts}]\n[[drive]]"


def written(folder: Path, text: str) -> Path:
    path = folder / "gateway.toml"
    path.write_text(text)
    return path


def test_the_shipped_gateway_configuration_is_valid() -> None:
    settings = load(ROOT / "config" / "gateway.toml")
    assert [drive.name for drive in settings.drive] == ["axis-1", "axis-2"]


def test_everything_listens_on_loopback_unless_told_otherwise(tmp_path: Path) -> None:
    settings = load(written(tmp_path, GOOD))
    assert settings.modbus_server.host == settings.dashboard.host == "127.0.0.1"
    assert settings.zenoh.listen == ("tcp/127.0.0.1:7447",) and not settings.zenoh.scouting


@pytest.mark.parametrize(
    ("change", "where", "expected"),
    [
        (("counts_per_turn", "counts_per_trun"), "drive[0].channels[0]", "did you mean `counts_per_turn`?"),
        (("131072", '"many"'), "drive[0].channels[0].counts_per_turn", "'many': expected a number above 0"),
        (("131072", "-1"), "drive[0].channels[0].counts_per_turn", "-1: expected a number above 0"),
        (('source = "can0"', 'source = "can1"'), "drive[0].channels[0].source", "expected one of ['can0']"),
        (
            ("modbus_device_id = 1", "modbus_device_id = 300"),
            "drive[0].modbus_device_id",
            "300: expected a whole number, 1 to 247",
        ),
        (('name = "can0"', 'name = "can 0"'), "can[0].name", "'can 0': expected a name of letters, digits"),
        (("[[drive]]", "[[drives]]"), "top level", "did you mean `drive`?"),
        (("[[can]]", "[can]"), "can", "a single table: expected [[can]]"),
        (('channel = "can0"', 'channel = "can0'), "not valid TOML", "line"),
        (("131072", "inf"), "drive[0].channels[0].counts_per_turn", "expected a finite number"),
        (("[[drive]]", "[[drive]]\nrate_hz = 1e9"), "drive[0].block_samples", "expected a block of 0.01 to 10 s"),
        (("[[can]]", '[zenoh]\nlisten = ["127.0.0.1:7447"]\n[[can]]'), "zenoh.listen[0]", "tcp/127.0.0.1:7447"),
        (("[[can]]", '[zenoh]\nmode = "clinet"\n[[can]]'), "zenoh.mode: 'clinet'", "did you mean 'client'?"),
        (("[[can]]", '[zenoh]\nmode = "client"\n[[can]]'), "zenoh.connect", "expected the router's endpoint"),
        (("[[can]]", '[zenoh]\nlisten = ["tls/127.0.0.1:7447"]\n[[can]]'), "zenoh.tls", "missing: expected it with ca"),
        (("[[can]]", '[zenoh]\n[zenoh.tls]\nca = "ca.pem"\n[[can]]'), "zenoh.listen", "tls/0.0.0.0:7447"),
        (
            ("[[can]]", '[zenoh]\nlisten = ["tls/127.0.0.1:7447"]\n[zenoh.tls]\nca = "ca.pem"\n[[can]]'),
            "zenoh.tls.certificate",
            "to listen with",
        ),
        (
            ("[[can]]", '[zenoh]\nlisten = ["tls/127.0.0.1:7447"]\n[zenoh.tls]\nca = "a"\nkey = "k"\n[[can]]'),
            "zenoh.tls.key",
            "both certificate and key",
        ),
        (("[[can]]", '[zenoh]\nuser = "ida"\n[[can]]'), "zenoh.password_file", "both user and password_file"),
        (("[[can]]", "[modbus_server]\nport = 8080\n[[can]]"), "dashboard.port", "expected another"),
        (("[[can]]", "[dashboard]\nport = 7447\n[[can]]"), "zenoh.listen[0]", "expected another port"),
        (
            ("[[drive.channels]]", "[drive.sound]\nsource = 'can0'\nsignal = 's'\nlow_hz = 2e4\n[[drive.channels]]"),
            "drive[0].sound.low_hz",
            "expected below high_hz",
        ),
        (("[[drive]]", sensor("0, type = 'f32'", "1")), "modbus[0].reads[1].address", "'s1' overlaps 's0' at 1"),
        (("[[drive]]", sensor("0, count = 4, type = 'bands_f32'", "15")), "modbus[0].reads[1].address", "overlaps"),
        (("[[drive]]", sensor("65535, type = 'u32'")), "modbus[0].reads[0].address", "expected at most 65535"),
        (("[[drive]]", sensor("0").replace("[[drive]]", sensor("0").replace("air", "gas"))), "modbus.serial", "twice"),
        (("[[drive]]", bus("0x76", "0x76")), "i2c[0].devices.address", "118 appears twice"),
        (
            (
                "[[drive]]",
                bus("0x76").replace(
                    "preset = 'bmp280'", "registers = [{signal='a', register=1}, {signal='b', register=1}]"
                ),
            ),
            "i2c[0].devices[0]: register",
            "1 appears twice",
        ),
    ],
)
def test_a_mistake_is_one_line_that_says_where_and_what(
    tmp_path: Path, change: tuple[str, str], where: str, expected: str
) -> None:
    path = written(tmp_path, GOOD.replace(*change))
    with pytest.raises(SettingsError) as caught:
        load(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ") and "\n" not in line
    assert where in line and expected in line


def test_two_drives_cannot_share_a_device_id(tmp_path: Path) -> None:
    second = GOOD[GOOD.index("[[drive]]") :].replace("axis-1", "axis-2")
    with pytest.raises(SettingsError, match=r"drive\.modbus_device_id: 1 appears twice"):
        load(written(tmp_path, GOOD + second))


def test_registers_that_only_touch_are_no_overlap(tmp_path: Path) -> None:
    touching = sensor("0, type = 'f32'", "2", "3, table = 'holding'", "3", "3, device_id = 9")
    assert len(load(written(tmp_path, GOOD.replace("[[drive]]", touching))).modbus[0].reads) == 5


def test_the_mark_that_some_editors_put_first_is_skipped(tmp_path: Path) -> None:
    assert load(written(tmp_path, "\ufeff" + GOOD)).drive[0].name == "axis-1"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            ('"2:position_value"', '"2:position_valve"'),
            "signal: '2:position_valve' is no signal of 'can0': expected such",
        ),
        (('signal = "gear1.pressure"', 'signal = "gear1.presure"'), "expected such as gear1.pressure"),
        (('signal = "bands"\nref', 'signal = "band"\nref'), "drive[0].sound.signal: 'band' is no signal of 'acoustic'"),
        (("theta_out_rad", "theta_uot_rad"), "theta_out_rad: missing: a model of balance 'torsion' needs it"),
        (('"axis.model.toml"', '"gone.model.toml"'), "gone.model.toml: cannot read"),
        (('"CSG-20-100"', '"CSG-20-101"'), "is not in the catalogue"),
        (('"socketcan"', '"sockcan"'), "interface: 'sockcan' is unknown"),
        (("bus = 1 ", 'bus = "one" '), "expected a number"),
    ],
)
def test_what_the_file_names_is_looked_at(tmp_path: Path, change: tuple[str, str], line: str) -> None:
    shutil.copy(ROOT / "config" / "axis.model.toml", tmp_path)
    text = (ROOT / "config" / "gateway.toml").read_text()
    assert examined(written(tmp_path, text)).drive[0].name == "axis-1"
    assert change[0] in text
    with pytest.raises(BadInput, match=re.escape(line)) as caught:
        examined(written(tmp_path, text.replace(change[0], change[1])))
    assert "\n" not in str(caught.value)


def test_a_channel_waits_as_long_as_its_read_takes(tmp_path: Path) -> None:
    """What is asked every two seconds is not silent after half of one; what is stated holds."""
    more = """
[[drive.channels]]
channel = "temperature_degC"
source = "air"
signal = "s0"
unit = "degC"

[[drive.channels]]
channel = "pressure_Pa"
source = "housing"
signal = "d0.pressure"

[[drive.channels]]
channel = "humidity"
source = "air"
signal = "s1"
stale_after_s = 30.0
"""
    slow = sensor("0, period_s = 2.0", "1, period_s = 2.0").replace("[[drive]]", bus("0x76, period_s = 5.0"))
    rows = load(written(tmp_path, GOOD.replace("[[drive]]", slow) + more)).drive[0].channels
    fast, temperature, pressure, humidity = (row.patience_s for row in rows)
    assert fast < 1.0 and temperature > 2 * 2.0 and pressure > 2 * 5.0 and humidity == 30.0


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot read: No such file"):
        load(tmp_path / "nowhere.toml")


def test_a_binary_file_is_not_a_traceback(tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(SettingsError, match="not a text file"):
        load(path)


def test_safe_limits_lie_within_what_the_sensor_is_believed(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(GOOD + "safe_maximum = 9.0\nmaximum = 8.0\n")
    with pytest.raises(SettingsError, match=r"safe_maximum: 9\.0 is not below maximum 8\.0"):
        load(file)


def test_what_a_source_names_is_refused_with_the_name_of_the_configuration(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD.replace('channel = "can0"', 'channel = "can0"\ndbc = "gone.dbc"'))
    with pytest.raises(BadInput) as caught:
        examined(path)
    assert str(caught.value).startswith(f"{path}: can 'can0': dbc: ")


def test_a_bus_without_a_decoding_is_told_what_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"signal: 'In.position' is no signal of 'can0': expected .* `dbc` or `pdo`"
    ):
        examined(written(tmp_path, GOOD.replace('model = "axis.model.toml"', f'model = "{MODEL}"')))


def test_a_key_left_out_is_named_with_what_it_takes(tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"drive\[0\]\.modbus_device_id: missing: expected a whole number, 1 to 247"
    ):
        load(written(tmp_path, GOOD.replace("modbus_device_id = 1\n", "")))
