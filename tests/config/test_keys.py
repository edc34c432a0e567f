"""The list of keys against the settings themselves and a configuration that is known to be read."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edge_daemon.config.keys import REQUIRED, expected, keys, listing
from edge_daemon.config.settings import Section
from edge_daemon.errors import BadInput

CONFIG = Path(__file__).parents[2] / "config"


def used(table: dict[str, Any], section: str = "") -> Iterator[str]:
    """Paths of all keys in a document, indices left out."""
    for key, value in table.items():
        path = f"{section}.{key}" if section else key
        yield path
        for row in value if isinstance(value, list) else [value]:
            if isinstance(row, dict):
                yield from used(row, path)


@pytest.mark.parametrize("name", ["gateway.toml", "demo.toml", "excite_demo.toml"])
def test_every_key_of_the_shipped_configurations_is_listed(name: str) -> None:
    assert set(used(tomllib.loads((CONFIG / name).read_text()))) <= {key.path for key in keys()}


def test_every_field_of_every_section_is_listed() -> None:
    fields = {name for section in Section.__subclasses__() for name in section.__struct_fields__}
    assert fields == {key.name for key in keys()}


def test_types_limits_defaults_and_meanings_are_those_of_the_settings() -> None:
    rows = {key.path: key for key in keys()}
    port, signal = rows["modbus_server.port"], rows["drive.channels.signal"]
    assert (port.takes, port.default) == ("a whole number, 0 to 65535", "5020")
    assert (signal.takes, signal.default) == ("a text", REQUIRED)
    assert rows["dashboard.token_file"].meaning.startswith("file with the token")
    assert expected("drive[0].channels[3].stale_after_s") == "a number above 0"
    assert expected("drive[0].nothing") == ""


def test_a_section_can_be_asked_for_as_toml_writes_it() -> None:
    assert listing("[[i2c.devices]]").splitlines()[0] == "[[i2c.devices]]" and "crc8_sensirion" in listing("i2c")
    with pytest.raises(BadInput, match="'i3c' is no section: expected one of gateway, store"):
        listing("i3c")
