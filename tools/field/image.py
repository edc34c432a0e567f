"""The machine's disks: a small Debian with the product's package installed, booted once and kept as a snapshot."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path

from field import course
from field.cases import Bench
from field.machine import Machine

ROOT = Path(__file__).parents[2]
GUEST = Path(__file__).parent / "guest"
TOOLS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "qemu-img": "qemu-utils",
    "mmdebstrap": "mmdebstrap",
    "mkfs.ext4": "e2fsprogs",
}
"""Programs and the Debian packages that bring them."""
PACKAGES = (
    *("systemd", "systemd-sysv", "udev", "dbus", "kmod", "iproute2", "can-utils", "i2c-tools", "procps"),
    *("python3", "linux-image-amd64", "initramfs-tools"),
)
LEFT_OUT = (
    *("/usr/share/doc/*", "/usr/share/locale/*", "/usr/share/man/*"),
    *(f"/lib/modules/*/kernel/{name}/*" for name in ("sound", "drivers/gpu", "drivers/media", "drivers/net/wireless")),
    *(f"/lib/modules/*/kernel/drivers/{name}/*" for name in ("infiniband", "iio", "scsi", "net/ethernet")),
)
SOURCES = ("edge_daemon", "config", "systemd", "tools/debian", "tools/deb", "requirements.lock", "pyproject.toml")
MASKED = (
    *("proc-sys-fs-binfmt_misc.automount", "apt-daily.timer", "apt-daily-upgrade.timer", "e2scrub_all.timer"),
    *("fstrim.timer", "dpkg-db-backup.timer", "getty@tty1.service", "serial-getty@ttyS0.service"),
)
ENABLED = ("agent.service", "buses.service")
BUILT_BY = [Path(__file__).with_name(name) for name in ("image.py", "machine.py", "course.py")]
ROOT_SIZE, DATA_SIZE = "3G", "192M"
SETTLED_S = 60.0
"""A run is no longer young then, and what it loaded late is loaded."""


class CannotBuild(Exception):
    """What is missing here, in one line."""


def cache() -> Path:
    """Where images are kept."""
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return home / "edge-daemon-vm"


def missing() -> list[str]:
    """Debian packages that are not installed."""
    path = os.environ["PATH"] + ":/usr/sbin:/sbin"
    return [package for program, package in TOOLS.items() if not shutil.which(program, path=path)]


def call(*command: str | Path) -> None:
    """Runs a program. Raises `CannotBuild` with the last line of what it said."""
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        raise CannotBuild(f"{words[0]} failed: {' '.join(said)}")


def mark(paths: Iterable[Path], *words: str) -> str:
    """A name for the content of files."""
    digest = hashlib.sha256(repr(words).encode())
    for file in sorted(inner for path in paths for inner in ([path] if path.is_file() else path.rglob("*"))):
        if file.is_file() and "__pycache__" not in file.parts:
            digest.update(str(file.relative_to(ROOT)).encode() + file.read_bytes())
    return digest.hexdigest()[:12]


def build() -> Path:
    """The folder of the machine, made where what it is made of has changed. Raises `CannotBuild`."""
    if os.geteuid():
        raise CannotBuild("only root can build a Debian system")
    if missing():
        raise CannotBuild(f"not installed: {' '.join(missing())}")
    product = mark([ROOT / name for name in SOURCES])
    system = mark((), *PACKAGES, *LEFT_OUT)
    kept = cache() / f"machine-{mark([GUEST, *BUILT_BY], product, system)}"
    if not kept.exists():
        package = _package(product)
        making = cache() / "making"
        shutil.rmtree(making, ignore_errors=True)
        making.mkdir(parents=True)
        _disks(_debian(system), package, making)
        _boot(making)
        _only(kept, "machine-*")
        making.rename(kept)
    return kept


def _only(kept: Path, pattern: str) -> None:
    """Forgets what an older state of the sources made."""
    for old in cache().glob(pattern):
        if old != kept:
            shutil.rmtree(old)


def _package(product: str) -> Path:
    folder = cache() / f"package-{product}"
    if not list(folder.glob("*.deb")):
        _only(folder, "package-*")
        print("building the package", flush=True)
        call(ROOT / "tools" / "deb", "--out", folder)
    return next(folder.glob("*.deb"))


def _debian(system: str) -> Path:
    kept = cache() / f"debian-{system}"
    if not kept.exists():
        print("building a Debian system", flush=True)
        sources = Path("/etc/apt/sources.list.d/debian.sources")
        release = [
            row for row in Path("/etc/os-release").read_text().splitlines() if row.startswith("VERSION_CODENAME=")
        ]
        fresh = cache() / "fresh"
        shutil.rmtree(fresh, ignore_errors=True)
        call(
            *("mmdebstrap", "--mode=root", "--variant=minbase", f"--include={','.join(PACKAGES)}"),
            *(f"--dpkgopt=path-exclude={name}" for name in LEFT_OUT),
            *(release[0].partition("=")[2] if release else "stable", fresh),
            *([sources] if sources.exists() else []),
        )
        _only(kept, "debian-*")
        fresh.rename(kept)
    return kept


def _disks(debian: Path, package: Path, folder: Path) -> None:
    """Kernel, initrd and both disks; no loop device is needed."""
    print("making the disks", flush=True)
    root = folder / "root"
    call("cp", "-a", debian, root)
    call("cp", package, root / "root/edge-daemon.deb")
    call("chroot", root, "dpkg", "--force-unsafe-io", "--install", "/root/edge-daemon.deb")
    call("cp", "-r", GUEST, root / "usr/local/lib/field")
    course.write(root / "usr/local/lib/field")
    for unit in GUEST.glob("*.service"):
        shutil.copy(unit, root / "etc/systemd/system")
    for name in ("gateway.toml", "axis.model.toml", "drive.dbc"):
        source = {"gateway.toml": GUEST, "axis.model.toml": ROOT / "config"}.get(name, ROOT / "edge_daemon/rig")
        shutil.copy(source / name, root / "etc/edge-daemon")
    call("chroot", root, "systemctl", "mask", *MASKED)
    call("chroot", root, "systemctl", "enable", *ENABLED)
    (root / "etc/fstab").write_text("/dev/vda / ext4 defaults 0 1\n/dev/vdb /var/lib/private ext4 defaults 0 2\n")
    (root / "etc/hostname").write_text("gateway\n")
    (root / "etc/modprobe.d/field.conf").write_text("blacklist i2c_i801\nblacklist pcspkr\n")
    (root / "var/lib/private").mkdir(mode=0o700, exist_ok=True)
    (root / "etc/initramfs-tools/conf.d/small").write_text("MODULES=list\nCOMPRESS=gzip\n")
    (root / "etc/initramfs-tools/modules").write_text("virtio_pci\nvirtio_blk\next4\n")
    call("chroot", root, "update-initramfs", "-u")
    for name, source in (("vmlinuz", "vmlinuz-*"), ("initrd", "initrd.img-*")):
        shutil.copy(next((root / "boot").glob(source)), folder / name)
    (folder / "empty").mkdir(mode=0o700)
    for name, content, size in (("root", root, ROOT_SIZE), ("data", folder / "empty", DATA_SIZE)):
        call("mkfs.ext4", "-q", "-E", "lazy_itable_init=1", "-d", content, folder / f"{name}.raw", size)
        call("qemu-img", "convert", "-O", "qcow2", folder / f"{name}.raw", folder / f"{name}.qcow2")
        (folder / f"{name}.raw").unlink()
        shutil.rmtree(content)


def _boot(folder: Path) -> None:
    """Boots, begins to measure, and keeps that moment."""
    print("booting for the first time", flush=True)
    machine = Machine(folder)
    machine.start(snapshot=None)
    try:
        machine.until("systemctl is-system-running", lambda said: said in ("running", "degraded"), 300.0)
        machine.do("systemctl is-active buses.service")
        machine.do("systemctl start rig.service && systemctl start edge-daemon.service", 300.0)
        machine.until("journalctl -u edge-daemon -o cat", lambda said: "measuring" in said, 300.0, 5.0)
        time.sleep(SETTLED_S)
        # on a busy computer the watchdog may just have ended it; an adapter cannot stand in a snapshot
        Bench(machine).well(but_for="no such serial device")
        machine.do("sync")
        machine.save()
    finally:
        machine.cut()
