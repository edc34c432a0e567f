"""The configuration file, as types. An unknown key, a wrong type or a value out of range is an error."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from edge_daemon.channels import MOTOR_ORDERS
from edge_daemon.errors import BadInput

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(ge=1)]
Port = Annotated[int, Meta(ge=0, le=65535)]
DeviceId = Annotated[int, Meta(ge=1, le=247)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=64)]


class SettingsError(BadInput):
    """One line: file, where in it, what is wrong, what was expected."""


class Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all sections."""


STALE_AFTER_S = 0.5
"""A channel may be without a reading for so long if nothing is said: a wire that comes loose shows at once (guess)."""


class Gateway(Section, frozen=True, kw_only=True):
    site: Name = "site"
    """first part of every Zenoh key after strainwave/v1"""
    name: Name = "gateway"
    """second part of it, and the title of the page"""


class StoreSettings(Section, frozen=True, kw_only=True):
    file: str = "edge-daemon.sqlite"
    """relative to the configuration; its folder is made"""
    max_mib: Annotated[int, Meta(ge=8)] = 512
    """the ring never grows past this"""
    commit_every_s: Annotated[float, Meta(ge=1.0)] = 30.0
    """a power cut costs so much of the samples at most, and an SD card wears with every commit; events never wait"""
    keep_blocks: bool = True
    """the samples themselves, for export and Compare, beside the estimates"""


class ZenohTls(Section, frozen=True, kw_only=True):
    """Who is who on endpoints that begin with `tls/`. PEM files, relative to the configuration."""

    ca: str
    """only certificates signed by this are believed"""
    certificate: str | None = None
    """of this gateway; to listen, or where the other end wants one"""
    key: str | None = None
    """to that certificate"""
    clients: bool = True
    """whoever connects must bring a certificate as well"""


class Zenoh(Section, frozen=True, kw_only=True):
    enabled: bool = True
    mode: Literal["peer", "client", "router"] = "peer"
    """client of a router, a router itself, or one of equals"""
    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    """endpoints, such as tcp/127.0.0.1:7447; not used by a client"""
    connect: tuple[str, ...] = ()
    """endpoints of routers or peers"""
    scouting: bool = False
    """look for others by multicast"""
    queue: Count = 1000
    """messages kept while the network is away; the oldest is dropped first"""
    every_s: NotNegative = 1.0
    """each topic is published at most this often; a change of state goes at once; 0 is as often as there is news"""
    most_bytes_per_s: Positive = 2000.0
    """no drive sends more than this on average: topics come less often where they are long; not for `every_s` 0"""
    close_within_s: Positive = 3.0
    tls: ZenohTls | None = None
    user: str | None = None
    """with `password_file`: by which name this gateway gets in at the router"""
    password_file: str | None = None
    """holds the password alone; relative to the configuration"""
    users_file: str | None = None
    """lines of `name:password`: nobody else may connect to this gateway"""
    prior_key_file: str | None = None
    """holds the key of `fleet share`: priors signed with it are taken over, and none without this file"""


def zenoh_files(link: Zenoh) -> dict[str, str]:
    """Key below `[zenoh]` -> file that it names."""
    tls = {f"tls.{key}": getattr(link.tls, key) for key in ("ca", "certificate", "key")} if link.tls else {}
    rows = {
        **tls,
        "password_file": link.password_file,
        "users_file": link.users_file,
        "prior_key_file": link.prior_key_file,
    }
    return {key: file for key, file in rows.items() if file is not None}


class ModbusServer(Section, frozen=True, kw_only=True):
    enabled: bool = True
    host: str = "127.0.0.1"
    port: Port = 5020
    """below 1024 takes a privilege that the service has not"""
    word_order: Literal["big", "little"] = "big"
    """of 32-bit values; `test_float` tells"""
    max_clients: Count = 32
    """of one more, the longest silent has to go, or one of an address that has more than its share"""
    reserved: tuple[str, ...] = ()
    """addresses of PLCs that always get a seat, such as 192.168.7.20"""
    idle_s: Positive = 120.0
    """a connection without a request for this long is closed"""
    stale_after_s: Positive = 5.0
    """older data reads NaN"""


class DashboardSettings(Section, frozen=True, kw_only=True):
    enabled: bool = True
    host: str = "127.0.0.1"
    """loopback, or with a token or certificates an address of this computer"""
    port: Port = 8080
    allow_changes: bool = False
    """whether the page may change a model, take a change back and acknowledge alarms"""
    token_file: str | None = None
    """file with the token that readers must know; unless `host` is loopback, this or `tls_client_ca` is required"""
    tls_certificate: str | None = None
    """PEM file, chain included: the page is then served over https only"""
    tls_key: str | None = None
    """PEM file of the certificate's private key"""
    tls_client_ca: str | None = None
    """PEM file: a browser with a certificate signed by this needs no token; without `token_file` nobody else gets in"""

    @property
    def on_loopback(self) -> bool:
        """Whether only this machine can reach the page."""
        return self.host in ("127.0.0.1", "::1", "localhost")

    @property
    def scheme(self) -> str:
        """How an address of the page begins."""
        return "https" if self.tls_certificate else "http"


class Pdo(Section, frozen=True, kw_only=True):
    """One CANopen process data object: objects in the order of their mapping, least significant first."""

    cob_id: Annotated[int, Meta(ge=1, le=0x7FF)]
    """identifier on the bus, such as 0x181"""
    objects: tuple[str, ...]
    """such as `position_value` (0x6004), `position_actual` (0x6064); a wrong name is answered with all there are"""
    node: Annotated[int, Meta(ge=1, le=127)]
    synchronous: bool | None = None
    """latched at SYNC (transmission type 0 to 240): readings get the time of the SYNC; by default, if this gateway
    produces SYNC"""


class CanStamp(Section, frozen=True, kw_only=True):
    """A message that carries the instant at which its device latched the values.

    Messages of one `clock` share one mapping to the gateway's clock, so that no skew can arise between them.
    """

    message: str
    """as the DBC file names it"""
    signal: str
    seconds_per_count: Positive = 1e-6
    wrap_counts: Positive = 4_294_967_296
    clock: Name = "device"


class CanSource(Section, frozen=True, kw_only=True):
    """A CAN interface: frames are decoded by a DBC file, by CANopen objects, or both.

    Signals are named `Message.Signal` after the DBC file, `NODE:OBJECT` after CANopen.
    """

    name: Name
    interface: str = "socketcan"
    """python-can interface: socketcan, slcan, virtual, udp_multicast, ..."""
    channel: str
    """such as can0, or /dev/ttyACM0 for a serial adapter"""
    bitrate: Count | None = None
    """for adapters that python-can sets up; SocketCAN has it from the system"""
    dbc: str | None = None
    """file, relative to the configuration"""
    pdo: tuple[Pdo, ...] = ()
    stamps: tuple[CanStamp, ...] = ()
    sync_period_s: Positive | None = None
    """produce CANopen SYNC so that the encoders latch together"""
    start_nodes: bool = False
    """the nodes of `pdo` are started (CiA 301, NMT start) when the bus is opened: for a bus without a master"""
    map_pdos: bool = False
    """before that they are told to send what `pdo` says, by SDO, until their power is cut; no drive is enabled by it"""
    receive_buffer_bytes: Count = 1_048_576
    frames_per_wakeup: Count = 256
    silent_after_s: Positive = 1.0
    """without a known frame for this long the bus counts as degraded"""


class I2cRegister(Section, frozen=True, kw_only=True):
    """One value in a device: where it is, how wide, how to read it."""

    signal: Name
    """your name of it: channels ask for DEVICE.SIGNAL"""
    register: Annotated[int, Meta(ge=0, le=255)]
    type: Literal["u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "f32"] = "i16"
    byte_order: Literal["big", "little"] = "big"
    scale: float = 1.0
    """value = raw * scale + offset"""
    offset: float = 0.0
    crc: Literal["none", "crc8_sensirion", "smbus_pec"] = "none"


class I2cBurst(Section, frozen=True, kw_only=True):
    """An acoustic device that captures `samples` values and lets them be read in chunks."""

    signal: Name = "sound"
    control_register: Annotated[int, Meta(ge=0, le=255)]
    status_register: Annotated[int, Meta(ge=0, le=255)]
    data_register: Annotated[int, Meta(ge=0, le=255)]
    samples: Annotated[int, Meta(ge=16, le=1_048_576)]
    chunk_bytes: Annotated[int, Meta(ge=2, le=4096)] = 32
    rate_hz: Positive
    byte_order: Literal["big", "little"] = "little"
    scale: float = 1.0
    every_s: Positive = 1.0


class I2cDevice(Section, frozen=True, kw_only=True):
    name: Name
    """your name of it, the first half of its signals' names"""
    address: Annotated[int, Meta(ge=0x03, le=0x77)]
    """seven bits, such as 0x76"""
    preset: str | None = None
    """bmp280 or lps22hb: gives registers and conversion"""
    registers: tuple[I2cRegister, ...] = ()
    burst: I2cBurst | None = None
    period_s: Positive = 1.0
    retries: Annotated[int, Meta(ge=0, le=10)] = 2
    """of a read that failed"""


class I2cSource(Section, frozen=True, kw_only=True):
    """An I2C bus. Signals are named `DEVICE.SIGNAL`; a preset's are `pressure` [Pa] and `temperature` [degC]."""

    name: Name
    bus: Annotated[int, Meta(ge=0)] | str
    """number of /dev/i2c-N, or `sim:NAME` for a simulated bus"""
    devices: tuple[I2cDevice, ...]


class ModbusRead(Section, frozen=True, kw_only=True):
    """One value or block of a Modbus sensor."""

    signal: Name
    """your name of it"""
    device_id: DeviceId | None = None
    """another device on the same line; by default that of the source"""
    table: Literal["input", "holding"] = "input"
    address: Annotated[int, Meta(ge=0, le=65535)]
    """from 0, as on the wire"""
    type: Literal["u16", "i16", "u32", "i32", "f32", "waveform_i16", "waveform_f32", "bands_f32", "fifo_i16"] = "u16"
    word_order: Literal["big", "little"] = "big"
    count: Annotated[int, Meta(ge=1, le=65536)] = 1
    """values of a waveform, at most so many of a fifo, pairs (frequency, level) of bands"""
    scale: float = 1.0
    """value = raw * scale + offset"""
    offset: float = 0.0
    rate_hz: Positive | None = None
    """sampling rate of a waveform"""
    averages: Positive = 1.0
    """independent averages behind band levels"""
    period_s: Positive = 1.0


class ModbusSource(Section, frozen=True, kw_only=True):
    name: Name
    transport: Literal["tcp", "rtu"] = "tcp"
    host: str = "127.0.0.1"
    port: Port = 502
    serial: str | None = None
    """of rtu: the port, best by its /dev/serial/by-id name"""
    baud: Count = 19200
    parity: Literal["N", "E", "O"] = "E"
    device_id: DeviceId = 1
    timeout_s: Positive = 1.0
    reads: tuple[ModbusRead, ...]


class FileSource(Section, frozen=True, kw_only=True):
    """A recording (CSV, Parquet) or a CAN log (candump .log, .asc, .blf) played as if it came from a bus."""

    name: Name
    file: str
    speed: NotNegative = 1.0
    """1 = as recorded, 0 = as fast as it goes"""
    dbc: str | None = None
    pdo: tuple[Pdo, ...] = ()
    stamps: tuple[CanStamp, ...] = ()


SourceSettings = CanSource | I2cSource | ModbusSource | FileSource


class ChannelSettings(Section, frozen=True, kw_only=True):
    """Where a channel comes from and how its raw value becomes SI."""

    channel: str
    """theta_in_rad, theta_out_rad, ..., or a name of your own"""
    source: Name
    signal: str
    """as the source names it: Message.Signal, NODE:OBJECT, DEVICE.SIGNAL or a read's signal"""
    unit: str = "SI"
    """unit of `raw * scale + offset`, such as degC, kPa, rpm, mA: it becomes the channel's own"""
    scale: float = 1.0
    offset: float = 0.0
    """for an encoder in radians"""
    counts_per_turn: Positive | None = None
    """an encoder: raw counts become radians, instead of scale and unit"""
    wrap_counts: Positive | None = None
    """the counter rolls over at this many counts; unwrapped to a multi-turn angle"""
    grating_nm: Positive | None = None
    """a fibre Bragg grating: its wavelength at 25 degC without strain. Raw nm become strain, then scale and unit"""
    grating_per_K: NotNegative = 9.15e-6
    """its relative growth by warmth: of a free fibre; 18.3e-6 glued to steel"""
    reverse: bool = False
    """negates the result, offset included"""
    latency_s: float = 0.0
    """a reading is this much older than its time stamp says"""
    minimum: float | None = None
    maximum: float | None = None
    """beyond these the sensor is not believed"""
    safe_minimum: float | None = None
    safe_maximum: float | None = None
    """beyond these the sensor is believed, and an alarm raised"""
    max_rate: Positive | None = None
    """largest believable change per second, channel's unit"""
    frozen_after_s: Positive | None = None
    """the very same value for this long is a fault"""
    stale_after_s: Positive | None = None
    """without a reading for this long the channel is silent; by default 0.5, or three periods of a slower read"""

    @property
    def patience_s(self) -> float:
        """How long the channel may be without a reading."""
        return STALE_AFTER_S if self.stale_after_s is None else self.stale_after_s


class Sound(Section, frozen=True, kw_only=True):
    """Which signal carries the sound, as a waveform or as band levels."""

    source: Name
    signal: str
    reference_hz: Positive = 300.0
    """f0 of the noise coefficients"""
    low_hz: Positive = 10.0
    high_hz: Positive = 10_000.0
    every_s: Positive = 1.0
    forget_s: Positive = 60.0
    """time constant of the averaged spectrum"""


class SoundAngle(Section, frozen=True, kw_only=True):
    """The motor angle from a waveform of its sound, for a drive without `theta_in_rad`; needs `[drive.sound]`."""

    order: Count = 1
    """of the motor's turn: whose tone is followed. A high one divides its phase error by its number"""
    other_orders: tuple[Count, ...] = MOTOR_ORDERS
    """that sound as well and must be taken off"""
    delay_s: float = 0.0
    """the sound is this much older than its time stamps say: air, sensor, path"""
    bandwidth_hz: Positive = 2.0
    """of the loop that keeps the place; the twist itself passes it by"""
    lowest_hz: Positive = 15.0
    """a slower tone is not followed"""
    wait_s: Positive = 3.0
    """blocks wait this long for their sound"""


class Estimation(Section, frozen=True, kw_only=True):
    cutoff_hz: Positive = 100.0
    """both sides of the balance pass this linear-phase filter"""
    warm_up_s: NotNegative = 5.0
    """nothing is valid before"""
    stiffness_drift_per_h: Positive = 1e-3
    """how fast a healthy gear may change, relative; the process noise"""
    baseline_after_s: Positive = 3600.0
    """commissioning: this much valid estimation before the baseline is learned"""
    encoder_noise_out_rad: NotNegative = 0.0
    """noise beyond quantisation, sd; 0 = quantisation of counts_per_turn only"""
    encoder_noise_in_rad: NotNegative = 0.0


class Profile(Section, frozen=True, kw_only=True):
    """A test motion of the motor from where it stands and back; needs `[drive.excite]`."""

    name: Name
    kind: Literal["sine", "multi_tone", "chirp", "steps", "slow_reversal"]
    speed_rad_s: Positive
    """motor, at its fastest"""
    seconds: Positive = 30.0
    """sine, multi_tone, chirp: how long at full size"""
    frequency_hz: tuple[Positive, ...] = ()
    """sine: one; multi_tone: several; chirp: from, to"""
    share: tuple[Positive, ...] = ()
    """multi_tone: speed of each tone against the others; left out: all alike"""
    travel_rad: Positive | None = None
    """steps: each step; slow_reversal: from end to end (motor)"""
    repeats: Count = 3
    """steps: how many each way; slow_reversal: how often there and back"""
    dwell_s: Positive = 1.0
    """steps: rest after each"""
    fade_s: Positive = 1.0
    """smooth start and stop"""


class ExciteLimits(Section, frozen=True, kw_only=True):
    """What a test motion may never pass: motor side, checked before it starts and in every cycle."""

    travel_rad: Positive
    """either way from where the motor stands"""
    minimum_rad: float | None = None
    """in the drive's own position"""
    maximum_rad: float | None = None
    speed_rad_s: Positive
    acceleration_rad_s2: Positive
    torque_Nm: Positive
    inertia_kg_m2: Positive
    """all that turns, seen from the motor; for the torque that a profile will need"""
    following_error_rad: Positive
    temperature_degC: float | None = None
    """where given, the drive's temperature channel must be alive"""


class Excite(Section, frozen=True, kw_only=True):
    """Test motions over CAN (CiA 402). Never without `allowed` and a command in which the drive's name is typed."""

    allowed: bool = False
    source: Name
    """CAN source"""
    node: Annotated[int, Meta(ge=1, le=127)]
    gateway_node: Annotated[int, Meta(ge=1, le=127)] = 126
    """whose heartbeat the drive must watch"""
    mode: Literal["position", "velocity"] = "position"
    counts_per_turn: Positive
    """drive's position unit, per motor turn; its velocity unit is the same per second"""
    rated_torque_Nm: Positive
    cycle_s: Annotated[float, Meta(ge=0.001, le=0.1)] = 0.004
    sync: bool = True
    """produce SYNC, one a cycle; False where another does, with the same period"""
    heartbeat_s: Annotated[float, Meta(ge=0.01, le=1.0)] = 0.1
    """a drive that hears nothing for this long stops itself"""
    dead_man_s: Annotated[float, Meta(ge=0.05, le=5.0)] = 0.5
    late_s: Positive = 0.05
    """a cycle later than this ends the motion"""
    stop_within_s: Positive = 2.0
    limits: ExciteLimits
    profile: tuple[Profile, ...] = ()


class Drive(Section, frozen=True, kw_only=True):
    name: Name
    modbus_device_id: DeviceId
    """under which a PLC finds its registers"""
    model: str
    """model file, relative to the configuration"""
    gear: str | None = None
    """size in the catalogue of gears (e.g. `CSG-20-100`) or a TOML file"""
    prior: str | None = None
    """what `learn` or `fleet learn` has written of such gears; without it the maker's law, or what the fleet signs"""
    rate_hz: Positive = 1000.0
    """of the common time base"""
    block_samples: Count = 100
    """at once; a block of 0.1 s is usual"""
    channels: tuple[ChannelSettings, ...]
    sound: Sound | None = None
    sound_angle: SoundAngle | None = None
    estimation: Estimation = Estimation()
    excite: Excite | None = None


class Settings(Section, frozen=True, kw_only=True):
    gateway: Gateway = Gateway()
    store: StoreSettings = StoreSettings()
    zenoh: Zenoh = Zenoh()
    modbus_server: ModbusServer = ModbusServer()
    dashboard: DashboardSettings = DashboardSettings()
    can: tuple[CanSource, ...] = ()
    i2c: tuple[I2cSource, ...] = ()
    modbus: tuple[ModbusSource, ...] = ()
    file: tuple[FileSource, ...] = ()
    drive: tuple[Drive, ...] = field(default_factory=tuple)

    @property
    def sources(self) -> tuple[SourceSettings, ...]:
        """All sources, in the order of the file's sections."""
        return (*self.can, *self.i2c, *self.modbus, *self.file)
