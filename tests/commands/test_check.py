"""What `check` remarks and `export` refuses: mistakes that people make beside a gateway."""

from __future__ import annotations

import time
import zipfile
from pathlib import Path

import pytest

from edge_daemon.commands.check import export, report, since_s
from edge_daemon.errors import BadInput
from edge_daemon.recordings.recording import read_recording

CONFIG = Path(__file__).parents[2] / "config"
EVENING_S = 1_795_302_000.0
"""2026-11-21 23:00:00 UTC"""


def checked(folder: Path, *changes: tuple[str, str], inertia: bool = True) -> list[str]:
    """The notes of `check` on the shipped configuration with changes."""
    text = (CONFIG / "gateway.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    lines = (CONFIG / "axis.model.toml").read_text().splitlines()
    kept = [line for line in lines if inertia or not line.startswith("output_inertia")]
    (folder / "axis.model.toml").write_text("\n".join(kept))
    (folder / "gateway.toml").write_text(text)
    return [line for line in report(folder / "gateway.toml").splitlines() if line.startswith("note: ")]


def test_the_shipped_configuration_gives_no_cause_for_remarks(tmp_path: Path) -> None:
    assert checked(tmp_path) == []


def test_a_channel_that_is_nearly_a_known_one_is_remarked(tmp_path: Path) -> None:
    (note,) = checked(tmp_path, ('channel = "temperature_degC"', 'channel = "temprature_degC"'))
    assert "drive[0].channels[3].channel" in note and "did you mean 'temperature_degC'?" in note


def test_a_channel_of_ones_own_is_not(tmp_path: Path) -> None:
    assert checked(tmp_path, ('channel = "temperature_degC"', 'channel = "oil_level"')) == []


def test_a_bit_rate_that_socketcan_does_not_use_is_remarked(tmp_path: Path) -> None:
    (note,) = checked(tmp_path, ('channel = "can0" ', 'bitrate = 500000\nchannel = "can0" '))
    assert note.startswith("note: can[0].bitrate: not used with socketcan")


def test_a_channel_that_waits_less_than_its_read_takes_is_remarked(tmp_path: Path) -> None:
    (note,) = checked(tmp_path, ("stale_after_s = 30.0", "stale_after_s = 4.0"))
    assert note.startswith("note: drive[1].channels[2].stale_after_s: 4: 'temperature' is read every 5 s")


@pytest.mark.parametrize(("stated", "good"), [('"K"', 0), ('"degF"', 0), ('"degC"', 1), ('"K"\noffset = 273.15', 1)])
def test_a_unit_that_a_preset_does_not_give_is_refused(tmp_path: Path, stated: str, good: bool) -> None:
    """25 degC read as 25 K would be -248 degC, and no sensor's fault."""
    change = ('unit = "degC"\nminimum', f"unit = {stated}\nminimum")
    if good:
        assert checked(tmp_path, change) == []
        return
    with pytest.raises(BadInput, match=r'drive\[0\]\.channels\[3\]\.unit: .* expected unit = "degC"'):
        checked(tmp_path, change)


def test_a_gateway_without_a_name_of_its_own_is_remarked(tmp_path: Path) -> None:
    (note,) = checked(tmp_path, ('site = "hall-3" ', "# "), ('name = "cell-7" ', "# "))
    assert note.startswith("note: gateway: site 'site', name 'gateway'")


def test_a_model_without_inertia_and_without_torque_is_remarked_for_each_drive(tmp_path: Path) -> None:
    found = checked(tmp_path, inertia=False)
    assert len(found) == 2 and all("output_inertia_kg_m2: missing" in note for note in found)


def test_a_time_without_zone_is_utc_wherever_the_gateway_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    time.tzset()
    try:
        assert since_s("2026-11-21 23:00", 0.0) == EVENING_S
        assert since_s("2026-11-22T00:00+01:00", 0.0) == EVENING_S
    finally:
        monkeypatch.delenv("TZ")
        time.tzset()


def test_ages_count_back_from_the_newest_sample() -> None:
    assert since_s("1.5h", EVENING_S) == EVENING_S - 5400.0
    with pytest.raises(BadInput, match=r"--since '1\.\.5h': expected seconds"):
        since_s("1..5h", EVENING_S)


def test_a_folder_in_place_of_the_store_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=f"{tmp_path}: cannot read: not a file: expected a store"):
        export(tmp_path, tmp_path / "out.csv", None, None)
    assert list(tmp_path.iterdir()) == []


def test_an_ending_that_is_no_recordings_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    store = tmp_path / "store.sqlite"
    store.touch()
    with pytest.raises(BadInput, match=r"out\.xlsx: ends in \.xlsx: expected \.csv or \.parquet"):
        export(store, tmp_path / "out.xlsx", None, None)


def test_a_workbook_is_called_one(tmp_path: Path) -> None:
    book = tmp_path / "robot.xlsx"
    with zipfile.ZipFile(book, "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    with pytest.raises(BadInput, match=r"a workbook \(\.xlsx\) or another archive: expected CSV or Parquet"):
        read_recording(book)
