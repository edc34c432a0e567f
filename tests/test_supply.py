"""What is said about the product's parts and promises is true of the tree."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import sbom

ROOT = Path(__file__).parents[1]


def test_the_bill_of_materials_names_every_locked_part_once_with_its_licence() -> None:
    bill = sbom.bill((ROOT / "requirements.lock").read_text(), "1.0")
    parts = {row["name"]: row for row in bill["components"]}
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    names = {re.split(r"[\[<>=]", row)[0] for row in wanted}
    assert names <= set(parts) and len(parts) == len(bill["components"])
    assert parts["numpy"]["purl"] == f"pkg:pypi/numpy@{parts['numpy']['version']}"
    assert sum("licenses" in row for row in bill["components"]) >= 0.8 * len(parts)


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-dev.lock"])
def test_every_locked_version_has_the_checksums_of_its_files(name: str) -> None:
    """Nothing else stands there, so that pip refuses whatever is not among them."""
    lock = (ROOT / name).read_text().partition("\n")[2]
    rows = re.split(r"\n(?! )", lock.strip())
    assert len(rows) > 40
    for row in rows:
        assert re.fullmatch(r"[\w.-]+==\S+( ; [^\\]+)?( \\\n {4}--hash=sha256:[0-9a-f]{64})+", row), row[:80]


def test_the_threat_model_names_tests_that_exist() -> None:
    named = set(re.findall(r"`(tests/[\w/.]+)`", (ROOT / "docs" / "threats.md").read_text()))
    assert len(named) > 10
    assert not [name for name in named if not (ROOT / name).exists()]
