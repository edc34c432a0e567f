"""Every mistake in a configuration gives one line: file, where, what, what was expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge_daemon.settings import SettingsError, load

ROOT = Path(__file__).parent.parent
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
        (("131072", '"many"'), "drive[0].channels[0].counts_per_turn", "expected `float | null`, got `str`"),
        (("131072", "-1"), "drive[0].channels[0].counts_per_turn", "> 0"),
        (('source = "can0"', 'source = "can1"'), "drive[0].channels[0].source", "expected one of ['can0']"),
        (("modbus_device_id = 1", "modbus_device_id = 300"), "drive[0].modbus_device_id", "<= 247"),
        (('name = "can0"', 'name = "can 0"'), "can[0].name", "matching regex"),
        (("[[drive]]", "[[drives]]"), "top level", "did you mean `drive`?"),
        (("[[can]]", "[can]"), "can", "array"),
        (('channel = "can0"', 'channel = "can0'), "not valid TOML", "line"),
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


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot read: No such file"):
        load(tmp_path / "nowhere.toml")


def test_a_binary_file_is_not_a_traceback(tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(SettingsError, match="not a text file"):
        load(path)
