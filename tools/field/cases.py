"""What goes wrong in a cabinet, done to the running service one after the other.

A case is a function of the bench. It raises `GuestError` where the daemon did not survive; what it returns is how long
the service was away (seconds of the guest's clock), None where it never was.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from field.machine import GuestError, Machine

UNIT = "edge-daemon.service"
STORE = "/var/lib/private/edge-daemon/store.sqlite"
SLOW_S = 400.0
"""An emulated start takes half a minute on an idle computer (guess), and CI is not idle."""
EXPOSURE = 1.4
T = TypeVar("T")


@dataclass(slots=True)
class Bench:
    """The machine, and questions to the service in it."""

    machine: Machine
    began_s: float = 0.0
    """of the case that runs, on the guest's clock"""

    def do(self, command: str, timeout_s: float = 60.0) -> str:
        return self.machine.do(command, timeout_s)

    def check(self, holds: bool, otherwise: str) -> None:
        if not holds:
            raise GuestError(otherwise)

    def problems(self) -> list[str]:
        """What `/health` complains of."""
        answer = self.machine.page("/health")
        return list(json.loads(answer.said)["problems"]) if answer.code in (200, 503) else [f"no page: {answer.said}"]

    def well(self, within_s: float = SLOW_S, but_for: str = "") -> None:
        """Waits until nothing is wrong any more, except perhaps what contains `but_for`."""

        def rest(found: list[str]) -> list[str]:
            return [row for row in found if not but_for or but_for not in row]

        self._until(self.problems, lambda found: not rest(found), within_s, "still wrong")

    def unwell(self, word: str, within_s: float = 60.0) -> None:
        """Waits until `/health` names the trouble."""
        self._until(self.problems, lambda found: any(word in row for row in found), within_s, f"not told: {word}")

    def told(self, word: str, within_s: float = 60.0) -> None:
        """Waits until the journal says so, since the case began."""
        command = f"journalctl -u {UNIT} -o cat --since @{self.began_s:.0f}"
        self._until(lambda: self.do(command), lambda said: word in said, within_s, f"the journal does not say {word!r}")

    def _until(self, ask: Callable[[], T], good: Callable[[T], bool], within_s: float, otherwise: str) -> T:
        end_s = time.monotonic() + within_s
        while not good(found := ask()):
            if time.monotonic() > end_s:
                raise GuestError(f"{otherwise}: {str(found)[-600:]}")
            time.sleep(0.3)
        return found

    def rig_with(self, counter: str) -> dict[str, Any]:
        """What the rig says, as soon as this is above 0."""
        return self._until(
            lambda: dict(json.loads(self.do("cat /run/rig.json"))), lambda rig: rig[counter] > 0, 60.0, f"no {counter}"
        )

    def refused(self, path: str) -> None:
        """Waits until the page answers that a token is needed."""
        self._until(lambda: self.machine.page(path).code, lambda code: code == 401, 60.0, "not refused")

    def shown(self, name: str) -> str:
        """A property of the unit."""
        return self.do(f"systemctl show {UNIT} -p {name} --value")

    def uptime_s(self) -> float:
        return float(self.do("cut -d' ' -f1 /proc/uptime"))

    def away_s(self, since_s: float, pid: str) -> float:
        """Waits until another process is active; how long after `since_s` (uptime) that was."""
        command = f"systemctl show {UNIT} -p MainPID,ActiveState,ActiveEnterTimestampMonotonic --value"

        def again(said: str) -> bool:
            rows = said.split()
            return len(rows) == 3 and pid not in rows and "active" in rows

        end_s = time.monotonic() + SLOW_S
        while not again(said := self.do(command)):
            if time.monotonic() > end_s:
                raise GuestError(f"not active again: {said.split()}")
            time.sleep(0.5)
        entered_us = max(int(row) for row in said.split() if row.isdigit())
        return entered_us / 1e6 - since_s


Case = Callable[[Bench], float | None]


def reads_what_the_devices_say(bench: Bench) -> None:
    """Every bus, by the kernel's own drivers: filters are in the kernel, and a register's value arrives."""
    filters = bench.do("grep -c -E '(181|281|381)' /proc/net/can/rcvlist_fil; true")
    bench.check(int(filters) >= 3, f"no filters in the kernel: {filters}")
    rig = bench.rig_with("line")  # the adapter was only just plugged in
    # what i2c-stub's registers said, by the daemon's own reckoning
    rows = [row for row in bench.machine.page("/metrics").said.splitlines() if "temperature" in row and row[0] != "#"]
    bench.check(any(abs(float(row.split()[-1]) - rig["temperature_degC"]) < 1.0 for row in rows), f"{rows}")


def a_hung_loop(bench: Bench) -> float:
    pid, since_s = bench.shown("MainPID"), bench.uptime_s()
    bench.do(f"kill -STOP {pid}")
    away_s = bench.away_s(since_s, pid)
    bench.told("Watchdog timeout")
    return away_s


def a_short_pause(bench: Bench) -> None:
    """The process stands still for two seconds: the kernel's buffer and its stamps bridge that."""
    pid = bench.shown("MainPID")
    bench.do(f"kill -STOP {pid}; sleep 2; kill -CONT {pid}")
    bench.check(bench.shown("MainPID") == pid, "it was restarted")


def killed(bench: Bench) -> float:
    pid, since_s = bench.shown("MainPID"), bench.uptime_s()
    bench.do(f"kill -KILL {pid}")
    return bench.away_s(since_s, pid)


def restarted(bench: Bench) -> float:
    pid, since_s = bench.shown("MainPID"), bench.uptime_s()
    bench.do(f"systemctl restart {UNIT}", SLOW_S)
    return bench.away_s(since_s, pid)


def reloaded(bench: Bench) -> None:
    """A second CAN bus (vcan0) is added and taken away again while the drive is measured."""
    pid = bench.shown("MainPID")
    bus = '[[can]]\nname = "spare"\ninterface = "socketcan"\nchannel = "vcan0"\ndbc = "drive.dbc"\n'
    bench.do(f"cp /etc/edge-daemon/gateway.toml /root/; printf '%s' '{bus}' >> /etc/edge-daemon/gateway.toml")
    bench.do(f"systemctl reload {UNIT}")
    bench.told("configuration: taken over")
    bench.unwell("spare: no known frame")
    bench.do("for n in 1 2 3 4 5; do cansend vcan0 182#0000000000000000; sleep 0.2; done")
    bench.do("grep -q 'vcan0.*182' /proc/net/can/rcvlist_fil")
    bench.do(f"cp /root/gateway.toml /etc/edge-daemon/; systemctl reload {UNIT}")
    bench.well()
    bench.check(bench.shown("MainPID") == pid, "it was restarted")


def a_broken_configuration(bench: Bench) -> None:
    pid = bench.shown("MainPID")
    bench.do("cp /etc/edge-daemon/gateway.toml /root/; echo 'nonsense = 1' >> /etc/edge-daemon/gateway.toml")
    bench.do(f"systemctl reload {UNIT}")
    bench.told("not taken over")
    bench.do(f"cp /root/gateway.toml /etc/edge-daemon/; systemctl reload {UNIT}")
    bench.told("configuration: taken over")
    bench.check(bench.shown("MainPID") == pid, "it was restarted")


def the_link_down(bench: Bench) -> None:
    bench.do("ip link set can0 down")
    bench.unwell("can0")
    bench.do("ip link set can0 up")


def bus_off(bench: Bench) -> None:
    """The controller's error frames, as its driver passes them on; the emulated wire itself has no errors."""
    bench.do("cansend can0 20000040#0000000000000000")
    bench.unwell("bus-off")
    bench.do("cansend can0 20000100#0000000000000000")


def the_card_removed(bench: Bench) -> None:
    """The driver's module goes, and both interfaces with it."""
    bench.do("ip link set can0 down; ip link set can1 down; modprobe -r kvaser_pci")
    bench.unwell("can0")
    bench.do("sh /usr/local/lib/field/buses.sh")


def the_i2c_part_dead(bench: Bench) -> None:
    """Every register reads all ones, as a bus without its part does that pulls nothing down."""
    bench.do("touch /run/dead")
    bench.told("temperature_degC")
    bench.do("rm /run/dead")
    bench.told("temperature_degC: no longer")


def the_adapter_unplugged(bench: Bench) -> None:
    bench.machine.unplug()
    bench.unwell("line")
    bench.machine.plug()


def started_before_its_devices(bench: Bench) -> float:
    bench.do(f"systemctl stop {UNIT}", SLOW_S)
    bench.machine.unplug()
    bench.do("ip link set can0 down; ip link set can1 down; modprobe -r kvaser_pci")
    bench.do("for n in 1 2 3 4 5 6 7 8 9; do rmmod i2c-stub && exit 0; sleep 0.2; done; exit 1")
    since_s = bench.uptime_s()
    bench.do(f"systemctl start {UNIT}", SLOW_S)
    away_s = bench.away_s(since_s, "none")
    bench.unwell("can0")
    bench.do("sh /usr/local/lib/field/buses.sh")
    bench.machine.plug()
    return away_s


def clock_forward(bench: Bench) -> None:
    """As when the network's time arrives: an hour."""
    bench.do("date -s '+1 hour'")
    bench.well()


def clock_back(bench: Bench) -> None:
    bench.do("date -s '-1 hour'")
    bench.began_s -= 3600
    bench.told("set back by")


def disk_full(bench: Bench) -> None:
    bench.do("fallocate -l $(df -B1 --output=avail /var/lib/private | tail -1) /var/lib/private/full; true")
    bench.do("cat /dev/zero > /var/lib/private/fuller 2>/dev/null; true")
    bench.told("no space left", 120.0)
    bench.do("rm /var/lib/private/full /var/lib/private/fuller")
    bench.told("store: well again", 120.0)


def out_of_memory(bench: Bench) -> float:
    """The kernel kills a service that needs more than its limit; systemd starts it anew."""
    pid, since_s = bench.shown("MainPID"), bench.uptime_s()
    bench.do(f"systemctl set-property --runtime {UNIT} MemoryMax=40M MemoryHigh=infinity MemorySwapMax=0", SLOW_S)
    bench.told("oom-kill", SLOW_S)
    bench.do(f"systemctl revert {UNIT}", SLOW_S)
    return bench.away_s(since_s, pid)


def a_credential(bench: Bench) -> float:
    """A token that only systemd can read, handed over to the page."""
    bench.do("umask 77; echo 0123456789abcdef-secret > /root/token")
    bench.do(
        f"mkdir -p /etc/systemd/system/{UNIT}.d && printf '[Service]\\nLoadCredential=token:/root/token\\n'"
        f" > /etc/systemd/system/{UNIT}.d/token.conf && systemctl daemon-reload"
    )
    bench.do("cp /etc/edge-daemon/gateway.toml /root/")
    line = f'token_file = "/run/credentials/{UNIT}/token"'
    bench.do(f"sed -i '/^port = 8080/a {line}' /etc/edge-daemon/gateway.toml")
    away_s = restarted(bench)
    bench.refused("/api/state")
    ask = (
        "python3 -c \"import urllib.request as u; print(u.urlopen(u.Request('http://127.0.0.1:8080/api/state',"
        " headers={'Authorization': 'Bearer 0123456789abcdef-secret'})).status)\""
    )
    bench.check(bench.do(ask) == "200", "the token does not open the page")
    bench.do(f"rm -r /etc/systemd/system/{UNIT}.d; cp /root/gateway.toml /etc/edge-daemon/; systemctl daemon-reload")
    restarted(bench)
    return away_s


def the_journal(bench: Bench) -> None:
    """Priorities, not words: `journalctl -p warning` finds what is grave."""
    graver = bench.do(f"journalctl -u {UNIT} -p warning -o json -n 200 --output-fields=MESSAGE,PRIORITY").splitlines()
    rows = [json.loads(row) for row in bench.do(f"journalctl -u {UNIT} -o json -n 400").splitlines()]
    own = [row for row in rows if row.get("_COMM", "").startswith("edge-daemon")]
    bench.check(bool(graver) and {row["PRIORITY"] for row in own} >= {"4", "6"}, "all lines have one priority")
    bench.check(not any(str(row["MESSAGE"]).startswith(("<", "INFO")) for row in own), "the level stands in the text")


def the_unit(bench: Bench) -> None:
    """In the place where it is installed, with all that it names there."""
    said = bench.do(f"systemd-analyze verify {UNIT} 2>&1; true")
    bench.check(not said, f"systemd-analyze verify: {said}")
    exposure = bench.do(f"systemd-analyze security --no-pager {UNIT} | tail -1")
    found = [float(word) for word in exposure.split() if word.replace(".", "").isdigit()]
    bench.check(bool(found) and found[0] <= EXPOSURE, exposure)


def upgraded(bench: Bench) -> float:
    """The package once more, over the running service: store and configuration stay."""
    bench.do("echo '# by hand' >> /etc/edge-daemon/axis.model.toml")
    before = bench.do(f"systemctl start {UNIT} && stat -c %i {STORE}", SLOW_S)
    pid, since_s = bench.shown("MainPID"), bench.uptime_s()
    bench.do("dpkg --install --force-confold /root/edge-daemon.deb", 1200.0)
    away_s = bench.away_s(since_s, pid)
    bench.check(bench.do(f"stat -c %i {STORE}") == before, "another store")
    bench.do("tail -1 /etc/edge-daemon/axis.model.toml | grep -q 'by hand'")
    bench.well()
    return away_s


def purged(bench: Bench) -> None:
    bench.do("dpkg --purge edge-daemon", 600.0)
    names = "/etc /usr /opt /var"
    left = bench.do(
        f"find {names} -xdev -name '*edge-daemon*' -not -path '*/journal/*' 2>/dev/null; ls -A /var/lib/private"
    )
    left = "\n".join(row for row in left.splitlines() if "lost+found" not in row)
    bench.check(not left, f"left behind: {left}")
    bench.check(not bench.do("systemctl list-units --all --no-legend 'edge-daemon*' | grep -v not-found; true"), "unit")


@dataclass(frozen=True, slots=True)
class Fault:
    """A line of the table."""

    name: str
    case: Case
    short: bool = False
    """also in the short form"""
    counted: bool = True
    """whether what the store lacks can be told: not where the clock jumps"""
    destroys: bool = False
    """the service, and at last its data, are gone"""
    held: str = ""
    """the test that holds the same without a machine, where there is one"""


FAULTS = (
    Fault(
        "every bus is read, filters in the kernel",
        reads_what_the_devices_say,
        True,
        held="tests/acquire/test_can_readers.py",
    ),
    Fault("process stopped for 2 s", a_short_pause, True, held="tests/condition/test_conditioner.py"),
    Fault(
        "CAN link down, up",
        the_link_down,
        True,
        held="tests/service/test_daemon.py::test_a_bus_that_drops_is_said_and_taken_up_again",
    ),
    Fault(
        "CAN bus-off, restarted",
        bus_off,
        True,
        held="tests/acquire/test_can_bus.py::test_a_silent_bus_and_a_bus_off_are_told_and_pass",
    ),
    Fault(
        "CAN driver module removed",
        the_card_removed,
        True,
        held="tests/acquire/test_can_readers.py::test_a_dead_socket_is_a_link_down",
    ),
    Fault(
        "I2C part reads all ones",
        the_i2c_part_dead,
        True,
        held="tests/acquire/test_i2c.py::test_a_dead_device_gives_nan_and_harms_no_other",
    ),
    Fault(
        "serial adapter unplugged",
        the_adapter_unplugged,
        True,
        held="tests/acquire/test_modbus.py::test_a_serial_line_survives_silence_and_is_lost_when_pulled",
    ),
    Fault(
        "reload adds and removes a bus",
        reloaded,
        True,
        held="tests/service/test_daemon.py::test_hangup_takes_a_changed_configuration_over_and_keeps_what_was_buffered",
    ),
    Fault(
        "reload of a broken configuration",
        a_broken_configuration,
        True,
        held="tests/service/test_daemon.py::test_hangup_never_gives_up_a_good_configuration_for_one_that_cannot_run",
    ),
    Fault(
        "disk full",
        disk_full,
        True,
        held="tests/service/test_daemon.py::test_a_full_disk_costs_nothing_that_was_stored",
    ),
    Fault("unit: verify silent, exposure <= 1.4", the_unit, True, held="tests/test_systemd.py"),
    Fault("hung loop (watchdog)", a_hung_loop, True),
    Fault(
        "journal has priorities",
        the_journal,
        True,
        held="tests/service/test_log_limit.py::test_the_journal_is_told_how_grave_each_line_is",
    ),
    Fault(
        "killed",
        killed,
        held="tests/store/test_disk_troubles.py::test_a_kill_at_any_moment_loses_nothing_that_was_committed",
    ),
    Fault(
        "restart under load",
        restarted,
        held="tests/service/test_daemon.py::test_a_stopped_daemon_leaves_everything_stored_and_starts_where_it_was",
    ),
    Fault("started before its devices", started_before_its_devices),
    Fault("memory limit", out_of_memory),
    Fault("credential from systemd", a_credential),
    Fault(
        "clock set forward by 1 h",
        clock_forward,
        counted=False,
        held="tests/test_clock.py::test_a_step_ahead_is_followed_at_once_and_counted",
    ),
    Fault(
        "clock set back by 1 h",
        clock_back,
        counted=False,
        held="tests/service/test_daemon.py::test_a_clock_set_back_does_not_turn_data_time_back",
    ),
    Fault("restart with the clock behind the data", restarted, counted=False),
    Fault("package installed over itself", upgraded, counted=False, destroys=True, held="tests/test_deb.py"),
    Fault("package purged", purged, counted=False, destroys=True, held="tests/test_deb.py"),
)
