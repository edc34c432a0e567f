"""The table of drivers: each section opens its own, names its signals, and loads no library before it must."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from edge_daemon.acquire.drivers import open_source, signals_of, validate_source
from edge_daemon.config.settings import (
    CanSource,
    CanStamp,
    FileSource,
    I2cBurst,
    I2cDevice,
    I2cRegister,
    I2cSource,
    ModbusRead,
    ModbusSource,
    Pdo,
    SettingsError,
    SourceSettings,
)

HERE = Path(__file__).parent
PDO = (Pdo(cob_id=0x181, node=1, objects=("position_value", "padding_8")),)
BURST = I2cBurst(control_register=0, status_register=1, data_register=2, samples=16, rate_hz=1.0)
DEVICES = (
    I2cDevice(name="gear", address=0x76, preset="bmp280"),
    I2cDevice(name="mic", address=0x40, burst=BURST, registers=(I2cRegister(signal="level", register=9),)),
)
SOURCES: tuple[tuple[SourceSettings, set[str]], ...] = (
    (CanSource(name="s", interface="virtual", channel="c", pdo=PDO), {"1:position_value"}),
    (I2cSource(name="s", bus=1, devices=DEVICES), {"gear.pressure", "gear.temperature", "mic.sound", "mic.level"}),
    (ModbusSource(name="s", reads=(ModbusRead(signal="a", address=0),)), {"a"}),
    (FileSource(name="s", file="drive.dbc", pdo=PDO), {"1:position_value"}),
)


@pytest.mark.parametrize(("settings", "signals"), SOURCES, ids=lambda x: type(x).__name__)
def test_each_section_has_a_driver_that_names_its_signals(settings: SourceSettings, signals: set[str]) -> None:
    source = open_source(settings, HERE)
    assert source.name == "s"
    assert source.health().state == "starting"
    validate_source(settings, HERE)
    assert signals_of(settings, HERE) == signals


def test_the_columns_of_a_recording_are_known_only_when_it_is_read() -> None:
    assert signals_of(FileSource(name="s", file="r.csv"), HERE) is None


def test_the_signals_of_a_database() -> None:
    found = signals_of(CanSource(name="s", channel="c", dbc="drive.dbc"), HERE)
    assert found is not None
    assert {"EncoderIn.Count", "DriveState.Torque", "Switched.Voltage"} <= found


def test_a_simulated_bus_is_valid_though_nothing_opens_it() -> None:
    validate_source(I2cSource(name="s", bus="sim:gone", devices=DEVICES), HERE)
    with pytest.raises(SettingsError, match="is simulated: expected the number of /dev/i2c-N"):
        validate_source(I2cSource(name="s", bus="sim:gone", devices=DEVICES), HERE, simulated=False)
    with pytest.raises(SettingsError, match="expected a number, or a name that begins with sim:"):
        validate_source(I2cSource(name="s", bus="/dev/i2c-1", devices=DEVICES), HERE)


def test_a_stamp_of_an_unknown_message_is_refused_in_a_file_too() -> None:
    stamps = (CanStamp(message="Nobody", signal="LatchTime"),)
    with pytest.raises(SettingsError, match=r"file 's': stamps: no signal 'Nobody\.LatchTime'"):
        open_source(FileSource(name="s", file="x.log", dbc="drive.dbc", stamps=stamps), HERE)


def test_the_table_loads_no_library() -> None:
    code = "import sys, edge_daemon.acquire.drivers, edge_daemon.acquire.i2c, edge_daemon.recordings.recording\n"
    code += "print(sorted({m.split('.')[0] for m in sys.modules} & {'can','cantools','canopen','pymodbus','pyarrow'}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"
