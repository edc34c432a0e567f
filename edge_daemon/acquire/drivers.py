"""Which driver serves which section of the configuration. A driver's libraries are loaded when it is first needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edge_daemon.acquire.i2c_transfer import I2cBus
from edge_daemon.acquire.source import Source
from edge_daemon.settings import CanSource, FileSource, I2cSource, ModbusSource, SourceSettings

OpenI2c = Callable[[int | str], I2cBus]


def _can(settings: CanSource, base: Path, _open_i2c: OpenI2c | None) -> Source:
    from edge_daemon.acquire.can_bus import CanBus

    return CanBus(settings, base)


def _i2c(settings: I2cSource, _base: Path, open_i2c: OpenI2c | None) -> Source:
    from edge_daemon.acquire.i2c import I2c

    return I2c(settings, open_i2c)


def _modbus(settings: ModbusSource, _base: Path, _open_i2c: OpenI2c | None) -> Source:
    from edge_daemon.acquire.modbus import ModbusSensor

    return ModbusSensor(settings)


def _file(settings: FileSource, base: Path, _open_i2c: OpenI2c | None) -> Source:
    from edge_daemon.acquire.replay import Replay

    return Replay(settings, base)


DRIVERS: dict[type, Callable[..., Source]] = {
    CanSource: _can,
    I2cSource: _i2c,
    ModbusSource: _modbus,
    FileSource: _file,
}


def open_source(settings: SourceSettings, base: Path, i2c_bus: OpenI2c | None = None) -> Source:
    """The source for one section; nothing is opened before its `run`.

    `base` is the folder of the configuration, for files named relative to it. `i2c_bus` opens buses named `sim:...`.
    Raises `SettingsError` if a named file, part or signal does not exist or does not fit.
    """
    return DRIVERS[type(settings)](settings, base, i2c_bus)
