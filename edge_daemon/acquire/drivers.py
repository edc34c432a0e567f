"""Which driver serves which section of the configuration. A driver's libraries are loaded when it is first needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edge_daemon.acquire.i2c_transfer import I2cBus
from edge_daemon.acquire.source import Source
from edge_daemon.config.settings import CanSource, FileSource, I2cSource, ModbusSource, SettingsError, SourceSettings

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


def validate_source(settings: SourceSettings, base: Path, simulated: bool = True) -> None:
    """Raises `BadInput` for what can be seen to be wrong without opening a bus: files, parts, decoding; for a simulated
    bus where there is none."""

    def never(name: int | str) -> I2cBus:
        raise AssertionError(f"{name} is not opened")

    open_source(settings, base, never if simulated else None)
    if isinstance(settings, FileSource) and not (base / settings.file).is_file():
        raise SettingsError(f"file {settings.name!r}: file: {base / settings.file}: cannot read: no such file")


def signals_of(settings: SourceSettings, base: Path) -> frozenset[str] | None:
    """The names a channel may take from this source; None if only the file, once open, can tell. Raises `BadInput`."""
    if isinstance(settings, ModbusSource):
        return frozenset(read.signal for read in settings.reads)
    if isinstance(settings, I2cSource):
        from edge_daemon.acquire.i2c import signals_of_device

        return frozenset(name for device in settings.devices for name in signals_of_device(device))
    if isinstance(settings, FileSource) and not (settings.dbc or settings.pdo):
        return None
    from edge_daemon.acquire.can_decode import layouts_of

    return frozenset(field.name for layout in layouts_of(settings, base).values() for field in layout.fields)
