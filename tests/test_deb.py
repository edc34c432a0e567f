"""The Debian package: what is in it, and what an installation, an upgrade and a purge do to a system.

Product and libraries are left out (`tools/deb --bare`); `tools/vm` installs the whole package in a machine of its own.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[1] / "tools" / "deb"
needs = [name for name in ("dpkg-deb", "dpkg", "systemd-sysusers") if not shutil.which(name)]
pytestmark = [
    pytest.mark.skipif(bool(needs), reason=f"not installed: {', '.join(needs)}"),
    pytest.mark.skipif(not Path("/usr/bin/python3").exists(), reason="Debian's python3 is not installed"),
]
CONFIGURATION, MODEL = "etc/edge-daemon/gateway.toml", "etc/edge-daemon/axis.model.toml"
LEARNED = "var/lib/private/edge-daemon/store.sqlite"


def ran(*command: str | Path) -> str:
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """An older and a newer package, by version."""
    folder = tmp_path_factory.mktemp("packages")
    return {
        version: Path(ran(TOOL, "--bare", "--version", version, "--out", folder).strip()) for version in ("1.0", "1.1")
    }


@pytest.fixture
def system(tmp_path: Path) -> Iterator[Path]:
    """The root of a system without packages, its own dpkg database included."""
    for folder in ("var/lib/dpkg/updates", "var/lib/dpkg/info", "etc"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "var/lib/dpkg/status").touch()
    yield tmp_path


def dpkg(root: Path, *arguments: str | Path) -> None:
    forced = ("--force-not-root", "--force-depends", "--force-script-chrootless", "--force-bad-path")
    ran("dpkg", f"--root={root}", f"--log={root}/var/log.dpkg", *forced, "--force-confold", *arguments)


def files(root: Path) -> set[str]:
    """Everything but what dpkg keeps of itself, and the system's table of groups."""
    found = {str(path.relative_to(root)) for path in root.rglob("*") if not path.is_dir() or path.is_symlink()}
    return (
        {name for name in found if not name.startswith(("var/lib/dpkg/", "var/log.dpkg"))}
        - {f"etc/{table}{kept}" for table in ("group", "gshadow", "passwd", "shadow") for kept in ("", "-")}
        - {"etc/.pwd.lock"}
    )


def test_the_package_holds_service_groups_and_configuration(packages: dict[str, Path]) -> None:
    listed = ran("dpkg-deb", "--contents", packages["1.0"])
    assert all(row.split()[1] == "root/root" for row in listed.splitlines())
    for name in ("usr/lib/systemd/system/edge-daemon.service", "usr/lib/sysusers.d/edge-daemon.conf"):
        assert f" ./{name}\n" in listed
    assert ran("dpkg-deb", "--info", packages["1.0"], "conffiles").split() == [f"/{MODEL}", f"/{CONFIGURATION}"]
    assert ran("dpkg-deb", "--field", packages["1.0"], "Version").strip() == "1.0"


def test_the_unit_starts_what_the_package_brings(packages: dict[str, Path]) -> None:
    listed = ran("dpkg-deb", "--contents", packages["1.0"])
    unit = (TOOL.parents[1] / "systemd" / "edge-daemon.service").read_text()
    start = next(row for row in unit.splitlines() if row.startswith("ExecStart=")).removeprefix("ExecStart=").split()
    assert f" .{start[0]}\n" in listed
    assert f" .{start[-1]}\n" in listed


@pytest.mark.skipif(os.geteuid() != 0, reason="dpkg gives files to root, which only root may do")
def test_an_upgrade_keeps_what_was_changed_and_learned_and_a_purge_leaves_nothing(
    packages: dict[str, Path], system: Path
) -> None:
    before = files(system)
    dpkg(system, "--install", packages["1.0"])
    assert "i2c" in {row.split(":")[0] for row in (system / "etc/group").read_text().splitlines()}
    (system / CONFIGURATION).write_text("# changed by hand\n")
    (system / LEARNED).parent.mkdir(parents=True)
    (system / LEARNED).write_bytes(b"what was learned")
    dpkg(system, "--install", packages["1.1"])
    assert (system / CONFIGURATION).read_text() == "# changed by hand\n"
    assert (system / LEARNED).read_bytes() == b"what was learned"
    dpkg(system, "--remove", "edge-daemon")
    assert (system / CONFIGURATION).exists() and (system / LEARNED).exists()
    assert not (system / "usr/lib/systemd/system/edge-daemon.service").exists()
    dpkg(system, "--purge", "edge-daemon")
    assert files(system) - before == set()


def test_an_unknown_option_is_one_line() -> None:
    done = subprocess.run([TOOL, "--fast"], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
