"""What installers get wrong: each mistake is one line that names the place, what stands there and what to put."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from edge_daemon.commands.check import report
from edge_daemon.errors import BadInput

CONFIG = Path(__file__).parents[2] / "config"
MISTAKES = {
    "the same signal for both angles": (
        ('signal = "2:position_value"', 'signal = "1:position_value"'),
        "drive[0].channels[1].signal: '1:position_value' is theta_in_rad already: expected that of theta_out_rad",
    ),
    "an address as i2cdetect prints it": (
        ("address = 0x76", "address = 76"),
        "gear1: address: 76 is 0x4C: expected 0x76 or 0x77: did you mean 0x76?",
    ),
    "a unit on a part that gives SI": (
        ('unit = "Pa"', 'unit = "hPa"'),
        "drive[0].channels[4].unit: 'hPa': the preset gives 'gear1.pressure' in Pa: expected unit = \"Pa\", or a scale",
    ),
    "a counter that ends one count early": (
        ("wrap_counts = 4294967296\nstale_after_s = 0.2\nmax_rate = 400.0", "wrap_counts = 131071"),
        "drive[0].channels[0].wrap_counts: 131071: no whole turns of 131072 counts, and no power of two: "
        "expected such as 131072",
    ),
    "a counter wider than its signal": (
        ("wrap_counts = 4294967296\nstale_after_s = 0.2\nmax_rate = 4.0", "wrap_counts = 1099511627776"),
        "drive[0].channels[1].wrap_counts: 1099511627776: '2:position_value' has 32 bits and rolls over at 4294967296",
    ),
    "a serial sensor without its port": (
        ('serial = "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A10KZ1-if00-port0"\n', ""),
        "modbus 'acoustic': serial: missing: expected the port of the RTU line",
    ),
    "a unit as it is spoken": (
        ('unit = "N m"', 'unit = "Nm"'),
        "drive[0].channels[2].unit: 'Nm' is unknown: did you mean 'N m'?",
    ),
    "per mille taken for newton metres": (
        ("scale = 0.00064 ", "# scale = 0.00064 "),
        "drive[0].channels[2].scale: missing: '3:torque_actual' is in per mille: expected a thousandth of the rated",
    ),
    "counts taken for radians": (
        ("counts_per_turn = 16777216            # 24 bits\nwrap_counts = 4294967296", ""),
        "drive[0].channels[1].counts_per_turn: missing: '2:position_value' is in counts",
    ),
    "a unit beside counts": (
        ("counts_per_turn = 131072 ", 'unit = "deg"\ncounts_per_turn = 131072 '),
        "drive[0].channels[0].unit: 'deg': counts_per_turn makes radians of counts: expected one or the other",
    ),
    "the node of another encoder": (
        ('signal = "4:position_value"', 'signal = "6:position_value"'),
        "drive[1].channels[0].signal: '6:position_value' is no signal of 'can0': expected such as",
    ),
    "a single bracket": (
        ('[[drive]]\nname = "axis-2"', '[drive]\nname = "axis-2"'),
        "not valid TOML",
    ),
    "a register beyond the last": (
        ("address = 0, type", "address = 70000, type"),
        "modbus[1].reads[0].address: 70000: expected a whole number, 0 to 65535",
    ),
    "another gear size": (
        ('gear = "CSG-20-100"\nrate_hz', 'gear = "CSG-20-10"\nrate_hz'),
        "drive[0].gear: gear 'CSG-20-10' is not in the catalogue: expected a TOML file or one of CSG-20-50",
    ),
    "one device id for two drives": (
        ("modbus_device_id = 2", "modbus_device_id = 1"),
        "drive.modbus_device_id: 1 appears twice: expected a different one for each",
    ),
    "a unit of another system": (
        ('unit = "N m"', 'unit = "Nmm"'),
        "drive[0].channels[2].unit: 'Nmm' is unknown: did you mean 'mN m'?",
    ),
    "a scale of nought": (
        ("scale = 0.00064 ", "scale = 0 "),
        "drive[0].channels[2].scale: 0: every reading would be the same: expected another number",
    ),
    "the page for everybody": (
        ('host = "127.0.0.1"                    # any', 'host = "0.0.0.0"   # any'),
        "dashboard.token_file: missing: expected a file with a token",
    ),
}
"""Mistake -> (what stood there and what stands there now, the beginning of what is said)."""
NOTED = {
    "an address without 0x of a part that is no preset": (
        ('preset = "bmp280", period_s', 'registers = [{ signal = "temperature", register = 0 }, '
         '{ signal = "pressure", register = 2 }], period_s'),
        ("0x76", "76"),
        "i2c[0].devices[0].address: 76 is 0x4C: i2cdetect prints addresses without 0x: did you mean 0x76?",
    ),
    "bits instead of counts": (
        ("counts_per_turn = 131072 ", "counts_per_turn = 17 "),
        ("wrap_counts = 4294967296\nstale_after_s = 0.2\nmax_rate = 400.0", ""),
        "drive[0].channels[0].counts_per_turn: 17: did you mean 131072, an encoder of 17 bits?",
    ),
    "bits instead of counts of a counter of 32 bits": (
        ("counts_per_turn = 131072 ", "counts_per_turn = 17 "),
        ("", ""),
        "drive[0].channels[0].counts_per_turn: 17: did you mean 131072, an encoder of 17 bits?",
    ),
    "milliseconds for seconds": (
        ("stale_after_s = 0.2\nmax_rate = 400.0", "stale_after_s = 200\nmax_rate = 400.0"),
        ("", ""),
        "drive[0].channels[0].stale_after_s: 200: so many seconds it is not told that theta_in_rad is silent: "
        "did you mean 0.2?",
    ),
    "the output's limit for the motor": (
        ("max_rate = 400.0", "max_rate = 4.0"),
        ("", ""),
        "drive[0].channels: max_rate 4 rad/s of theta_in_rad and 4 of theta_out_rad: through the gear that is 400: "
        "expected limits of one motion",
    ),
    "a SYNC that no bus carries": (
        ("sync_period_s = 0.001 ", "sync_period_s = 0.0001 "),
        ("", ""),
        "can[0].sync_period_s: 0.0001: SYNC and its answers take 0.00067 s: expected a longer one",
    ),
    "an I2C part read faster than its bus": (
        ('preset = "bmp280", period_s = 1.0', 'preset = "bmp280", period_s = 0.0001'),
        ("", ""),
        "i2c[0].devices[0].period_s: 0.0001: a read takes 0.0005 s: expected a longer one",
    ),
    "a serial line that is too slow": (
        ("baud = 115200", "baud = 1200"),
        ("", ""),
        "modbus[0].reads: at 1200 baud the line is taken 2.5 times: expected longer periods",
    ),
    "an adapter by its place in a queue": (
        ("/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A10KZ1-if00-port0", "/dev/ttyUSB0"),
        ("", ""),
        "modbus[0].serial: '/dev/ttyUSB0': another adapter may have this name after the next start: expected the one "
        "under /dev/serial/by-id/",
    ),
    "one encoder for two drives": (
        ('signal = "5:position_value"', 'signal = "2:position_value"'),
        ("", ""),
        "drive[1].channels[1].signal: '2:position_value' is theta_out_rad of axis-1 as well",
    ),
    "a register as the manual numbers it": (
        ("address = 0, type", "address = 30001, type"),
        ("", ""),
        "modbus[1].reads[0].address: 30001: a manual's reference: did you mean 0, as on the wire?",
    ),
    "the model of another ratio": (
        ('gear = "CSG-20-100"\nrate_hz', 'gear = "CSG-20-80"\nrate_hz'),
        ("", ""),
        "joint.ratio: 100: the gear CSG-20-80 has 80",
    ),
}  # fmt: skip


def said(folder: Path, *changes: tuple[str, str]) -> str:
    """All that `check` says of the shipped configuration with changes."""
    text = (CONFIG / "gateway.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1) if old else text
    (folder / "axis.model.toml").write_text((CONFIG / "axis.model.toml").read_text())
    (folder / "gateway.toml").write_text(text)
    try:
        return report(folder / "gateway.toml")
    except BadInput as error:
        return f"{error}\n"


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_typical_mistake_is_refused_with_the_remedy(tmp_path: Path, mistake: str) -> None:
    change, line = MISTAKES[mistake]
    found = said(tmp_path, change)
    assert found.startswith(f"{tmp_path / 'gateway.toml'}: ") and found.count("\n") == 1
    assert line in found


@pytest.mark.parametrize("mistake", NOTED)
def test_what_may_be_meant_is_remarked(tmp_path: Path, mistake: str) -> None:
    *changes, line = NOTED[mistake]
    notes = [row for row in said(tmp_path, *changes).splitlines() if row.startswith("note: ")]
    assert any(line in row for row in notes), notes


def test_what_a_library_warns_of_is_no_word_to_a_user() -> None:
    """A division by zero in a sum over recordings was printed with a line of code."""
    warns = "cli.main = lambda: warnings.warn('divide by zero', RuntimeWarning) or 0"
    code = f"import warnings; from edge_daemon import cli; {warns}; cli.command()"
    for arguments, said in (((), False), (("-W", "default"), True)):
        ended = subprocess.run([sys.executable, *arguments, "-c", code], capture_output=True, text=True, timeout=60)
        assert ended.returncode == 0 and ("divide by zero" in ended.stderr) is said
