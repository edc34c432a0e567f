"""In the guest: the simulated drive on the CAN card can1, in the registers of i2c-stub, and on Modbus TCP and RTU.

The drive itself is simulated outside (`course.py`): an emulated processor could not keep up. Here its course is played,
forth and back, with nothing but the standard library and smbus2: none of the product's own protocol code.
"""

import contextlib
import json
import os
import socket
import socketserver
import struct
import sys
import termios
import threading
import time
from pathlib import Path

sys.path += [str(path) for path in Path("/opt/edge-daemon/.venv/lib").glob("python3*/site-packages")]
import smbus2

HERE = Path(__file__).parent
STATUS, DEAD = Path("/run/rig.json"), Path("/run/dead")
ROW = struct.Struct("<iihhi")
FRAME = struct.Struct("<IB3x8s")
ID_ENCODER_IN, ID_ENCODER_OUT, ID_DRIVE = 0x181, 0x281, 0x381
RATE_HZ, TICK_S, MOST_BEHIND = 100, 0.005, 100
LATCH_START_US = (1 << 32) - 20_000_000
BMP280 = 0x76
REGISTERS = [0] * 64
STATE = {"sent": 0, "dropped": 0, "skipped": 0, "line": 0, "temperature_degC": 0.0}


def course() -> list[tuple[int, ...]]:
    """Encoder counts, torque, current and speed at each hundredth of a second."""
    return list(ROW.iter_unpack((HERE / "course.bin").read_bytes()))


class Wire:
    """A raw CAN socket that is opened again when its interface comes back."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._socket: socket.socket | None = None

    def send(self, identifier: int, data: bytes) -> None:
        try:
            if self._socket is None:
                self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
                self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
                self._socket.bind((self._name,))
            self._socket.send(FRAME.pack(identifier, len(data), data))
            STATE["sent"] += 1
        except OSError as error:
            STATE["dropped"] += 1
            if error.errno != 105 and self._socket:  # not merely a full queue
                self._socket.close()
                self._socket = None


def drive(rows: list[tuple[int, ...]]) -> None:
    """Sends for ever, a row every 10 ms; what it is late for by more than a second is left out."""
    wire, began_s, number = Wire("can1"), time.monotonic(), 0
    while True:
        due = int((time.monotonic() - began_s) * RATE_HZ)
        if due - number > MOST_BEHIND:
            STATE["skipped"] += due - number - MOST_BEHIND
            number = due - MOST_BEHIND
        for n in range(number, due):
            at = n % (2 * len(rows))
            counts_in, counts_out, torque, current, speed = rows[min(at, 2 * len(rows) - 1 - at)]
            latch = (LATCH_START_US + n * 1_000_000 // RATE_HZ) % (1 << 32)
            wire.send(ID_ENCODER_IN, struct.pack("<iI", counts_in, latch))
            wire.send(ID_ENCODER_OUT, struct.pack("<iI", counts_out, latch))
            if n % 2 == 0:
                wire.send(ID_DRIVE, struct.pack("<hhi", torque, current, speed))
            time.sleep(TICK_S / 2)  # the card holds five frames, and an emulated processor is slow to fetch them
        number = max(number, due)
        time.sleep(TICK_S)


def housing() -> None:
    """Once a second: the pressure sensor's registers, and the ones that Modbus serves."""
    shown = json.loads((HERE / "housing.json").read_text())
    for second in range(1 << 31):
        now = shown[second % len(shown)]
        with contextlib.suppress(OSError), smbus2.SMBus(0) as bus:  # the module may be away for a while
            for register, data in now["registers"].items():
                for i, value in enumerate(bytes.fromhex(data)):
                    bus.write_byte_data(BMP280, int(register) + i, 255 if DEAD.exists() else value)
        STATE["temperature_degC"] = now["temperature_degC"]
        REGISTERS[:4] = [round(now["temperature_degC"] * 100), round(now["pressure_Pa"] / 10), 2200, second & 0xFFFF]
        STATUS.with_suffix(".new").write_text(json.dumps(STATE))
        STATUS.with_suffix(".new").rename(STATUS)
        time.sleep(1.0)


def answered(request: bytes) -> bytes:
    """The answer to a request without its addressing: device, function, address, count."""
    device, function, address, count = struct.unpack(">BBHH", request)
    if function not in (3, 4) or address + count > len(REGISTERS):
        return bytes((device, function | 0x80, 2))
    words = REGISTERS[address : address + count]
    return struct.pack(f">BBB{count}H", device, function, 2 * count, *words)


class Attendant(socketserver.StreamRequestHandler):
    """Modbus TCP."""

    def handle(self) -> None:
        while len(head := self.rfile.read(6)) == 6:
            answer = answered(self.rfile.read(struct.unpack_from(">H", head, 4)[0]))
            self.wfile.write(head[:4] + struct.pack(">H", len(answer)) + answer)


def checked(data: bytes) -> bytes:
    """With the checksum of Modbus RTU."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return data + struct.pack("<H", crc)


def line() -> None:
    """Modbus RTU, 115200 baud, even parity, at the far end of the serial adapter."""
    port = os.open("/dev/ttyS1", os.O_RDWR | os.O_NOCTTY)
    mode = termios.CS8 | termios.CREAD | termios.CLOCAL | termios.PARENB
    characters = [b"\0"] * 32
    characters[termios.VMIN] = b"\1"
    termios.tcsetattr(port, termios.TCSANOW, [0, 0, mode, 0, termios.B115200, termios.B115200, characters])
    heard = b""
    while True:
        heard = (heard + os.read(port, 256))[-64:]
        for at in range(len(heard) - 7):
            if checked(heard[at : at + 6]) == heard[at : at + 8]:
                os.write(port, checked(answered(heard[at : at + 6])))
                STATE["line"] += 1
                heard = heard[at + 8 :]
                break


socketserver.ThreadingTCPServer.allow_reuse_address = True
server = socketserver.ThreadingTCPServer(("127.0.0.1", 1502), Attendant)
for task in (server.serve_forever, housing, line):
    threading.Thread(target=task, daemon=True).start()
drive(course())
