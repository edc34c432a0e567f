"""The Modbus server as PLCs meet it: a real client (mbpoll), and raw sockets for what no client should send."""

from __future__ import annotations

import asyncio
import re
import shutil
import struct
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

import msgspec
import pytest

from edge_daemon.config.settings import ModbusServer
from edge_daemon.publish.modbus_server import RegisterServer
from edge_daemon.publish.registers import BY_NAME, READS, TOTAL
from edge_daemon.records import NE107, Estimate, Snapshot, Status

NOW_S = 1_700_000_000.0
WITHIN_S = 5.0
pytestmark = pytest.mark.timeout(30)


def snapshot(drive: str, value: float, sequence: int = 1) -> Snapshot:
    row = Estimate("stiffness", value, 12.5, "N m/rad", Status.VALID, NOW_S)
    return Snapshot(drive, sequence, NOW_S, NE107.OK, (), {"stiffness": row})


@asynccontextmanager
async def serving(**settings: object) -> AsyncIterator[tuple[RegisterServer, int]]:
    server = RegisterServer(msgspec.convert({"port": 0} | settings, ModbusServer), {"left": 1, "right": 2})
    port = await server.start(NOW_S)
    try:
        yield server, port
    finally:
        await server.stop()


class Client:
    """Bytes on a socket, each wait bounded."""

    def __init__(self, port: int, own: str = "127.0.0.1") -> None:
        self.port, self.own = port, own

    async def __aenter__(self) -> Client:
        opening = asyncio.open_connection("127.0.0.1", self.port, local_addr=(self.own, 0))
        self.reader, self.writer = await asyncio.wait_for(opening, WITHIN_S)
        return self

    async def __aexit__(self, *_: object) -> None:
        self.writer.close()

    def send(self, data: bytes) -> None:
        self.writer.write(data)

    async def answer(self) -> tuple[int, int, bytes]:
        """Transaction, device id, PDU."""
        head = await asyncio.wait_for(self.reader.readexactly(7), WITHIN_S)
        transaction, protocol, length, device = struct.unpack(">HHHB", head)
        assert protocol == 0
        return transaction, device, await asyncio.wait_for(self.reader.readexactly(length - 1), WITHIN_S)

    async def read(self, address: int, count: int, *, function: int = 4, device: int = 1) -> list[int]:
        self.send(request(address, count, function=function, device=device))
        _, _, pdu = await self.answer()
        assert pdu[:2] == bytes((function, 2 * count)), pdu
        return list(struct.unpack(f">{count}H", pdu[2:]))

    async def closed(self) -> bool:
        """True once the server has closed; an answer instead is a failure."""
        try:
            return await asyncio.wait_for(self.reader.read(), WITHIN_S) == b""
        except ConnectionResetError:
            return True


def request(address: int, count: int, *, function: int = 4, device: int = 1, transaction: int = 7) -> bytes:
    return struct.pack(">HHHBBHH", transaction, 0, 6, device, function, address, count)


async def mbpoll(port: int, *options: str) -> dict[int, str]:
    """What Debian's mbpoll prints: reference -> value."""
    if not shutil.which("mbpoll"):
        pytest.skip("mbpoll is not installed")
    command = ["mbpoll", "-1", "-0", "-p", str(port), *options, "127.0.0.1"]
    process = await asyncio.create_subprocess_exec(*command, stdout=-1, stderr=-2)
    try:
        out, _ = await asyncio.wait_for(process.communicate(), 10.0)
    except TimeoutError:
        process.kill()
        raise
    assert process.returncode == 0, out.decode()
    return {int(at): value for at, value in re.findall(r"\[(\d+)\]:\s+(\S+)", out.decode())}


@pytest.mark.parametrize("table", ["3", "4"])
async def test_mbpoll_reads_constant_and_stiffness_from_both_tables(table: str) -> None:
    async with serving() as (server, port):
        await server.publish(snapshot("right", 31_234.5), NOW_S)
        options = ("-a", "2", "-t", f"{table}:float", "-B", "-r")
        assert float((await mbpoll(port, *options, "8"))[8]) == 12345.0
        at = BY_NAME["stiffness"].address
        found = await mbpoll(port, *options, str(at), "-c", "2")
        assert {at: float(found[at]), at + 2: float(found[at + 2])} == {at: 31_234.5, at + 2: 12.5}


async def test_mbpoll_reads_little_word_order_without_being_told_to_swap() -> None:
    async with serving(word_order="little") as (_, port):
        assert float((await mbpoll(port, "-t", "3:float", "-r", "8"))[8]) == 12345.0


async def test_mbpoll_sees_the_heartbeat_move_and_the_age_grow_without_new_data() -> None:
    async with serving() as (server, port):
        await server.publish(snapshot("left", 1.0), NOW_S)
        before = await mbpoll(port, "-t", "3", "-r", "4", "-c", "4")
        await server.tick(NOW_S + 2.0)
        after = await mbpoll(port, "-t", "3", "-r", "4", "-c", "4")
        assert int(after[4]) == int(before[4]) + 1
        assert [int(before[7]), int(after[7])] == [0, 2000]
        await server.tick(NOW_S + 6.0)
        assert (await mbpoll(port, "-t", "3:float", "-B", "-r", "58"))[58] == "nan"


async def test_any_block_inside_the_map_can_be_read_and_none_beyond() -> None:
    async with serving() as (_, port), Client(port) as client:
        for function in (3, 4):
            for first in range(TOTAL):
                for count in {1, 2, min(125, TOTAL - first)}:
                    if first + count <= TOTAL:
                        await client.read(first, count, function=function)
            for address, count in ((TOTAL, 1), (TOTAL - 1, 2), (65_535, 125), (TOTAL - 124, 125)):
                client.send(request(address, count, function=function))
                assert (await client.answer())[2] == bytes((function | 0x80, 2)), (address, count)


async def test_drives_keep_to_their_device_ids_and_an_unknown_id_is_told_so() -> None:
    async with serving() as (server, port), Client(port) as client:
        await server.publish(snapshot("left", 1.0), NOW_S)
        await server.publish(snapshot("right", 2.0), NOW_S)
        await server.publish(snapshot("without_id", 3.0), NOW_S)
        words = [await client.read(58, 2, device=device) for device in (1, 2)]
        assert [struct.unpack(">f", struct.pack(">HH", *pair))[0] for pair in words] == [1.0, 2.0]
        client.send(request(0, 1, device=9))
        assert await client.answer() == (7, 9, b"\x84\x0b")


@pytest.mark.parametrize("pdu", [
    b"\x05\x00\x00\xff\x00", b"\x06\x00\x00\x00\x01", b"\x0f\x00\x00\x00\x01\x01\x01",
    b"\x10\x00\x00\x00\x01\x02\x00\x01", b"\x16\x00\x00\x00\x00\x00\x01",
    b"\x17\x00\x00\x00\x01\x00\x00\x00\x01\x02\x00\x01", b"\x08\x00\x04\x00\x00", b"\x01\x00\x00\x00\x01", b"\x63",
])  # fmt: skip
async def test_everything_but_reading_registers_is_an_illegal_function_and_changes_nothing(pdu: bytes) -> None:
    async with serving() as (_, port), Client(port) as client:
        before = await client.read(0, 124)
        client.send(struct.pack(">HHHB", 9, 0, len(pdu) + 1, 1) + pdu)
        assert await client.answer() == (9, 1, bytes((pdu[0] | 0x80, 1)))
        assert await client.read(0, 124) == before


@pytest.mark.parametrize("pdu", [
    b"\x04\x00\x00\x00\x00", b"\x04\x00\x00\x00\x7e", b"\x04\x00\x00\xff\xff", b"\x03\x00", b"\x04\x00\x00\x00\x01\x00",
])  # fmt: skip
async def test_a_read_of_nothing_too_much_or_the_wrong_size_is_an_illegal_value(pdu: bytes) -> None:
    async with serving() as (_, port), Client(port) as client:
        client.send(struct.pack(">HHHB", 9, 0, len(pdu) + 1, 1) + pdu)
        assert await client.answer() == (9, 1, bytes((pdu[0] | 0x80, 3)))


@pytest.mark.parametrize("header", [
    struct.pack(">HHHB", 1, 0, 0, 1), struct.pack(">HHHB", 1, 0, 65_535, 1), struct.pack(">HHHB", 1, 1, 6, 1),
    struct.pack(">HHHB", 1, 0, 1, 1), struct.pack(">HHHB", 1, 0, 255, 1), b"GET / HTTP/1.1\r\n\r\n",
])  # fmt: skip
async def test_a_broken_header_drops_its_client_and_hurts_nobody_else(header: bytes) -> None:
    async with serving() as (server, port), Client(port) as good, Client(port) as bad:
        before = await good.read(8, 2)
        bad.send(header)
        assert await bad.closed()
        assert await good.read(8, 2) == before
        assert server.health().figures["dropped_broken_header"] == 1
        assert server.health().figures["clients"] == 1


async def test_requests_in_pieces_and_several_at_once_are_all_answered_in_order() -> None:
    async with serving() as (_, port), Client(port) as client:
        client.send(b"".join(request(8, 2, transaction=number) for number in range(16)))
        assert [(await client.answer())[0] for _ in range(16)] == list(range(16))
        for byte in request(8, 2):
            client.send(bytes((byte,)))
            await client.writer.drain()
            await asyncio.sleep(0)
        assert (await client.answer())[2] == b"\x04\x04" + struct.pack(">f", 12345.0)


async def test_a_client_that_sends_nothing_or_only_half_a_request_is_dropped() -> None:
    async with serving(idle_s=0.1) as (server, port), Client(port) as mute, Client(port) as half:
        half.send(request(0, 1)[:8])
        assert await mute.closed()
        assert await half.closed()
        assert server.health().figures["dropped_idle"] == 2


async def test_a_full_house_sends_the_newcomer_away_while_all_others_are_busy() -> None:
    async with serving(max_clients=2) as (server, port), Client(port) as first, Client(port) as second:
        for client in (first, second):
            await client.read(0, 1)
        async with Client(port) as third:
            assert await third.closed()
        assert [await client.read(0, 1) for client in (first, second)] == [[0x5357], [0x5357]]
        assert server.health().figures["dropped_full"] == 1


async def test_one_address_cannot_take_all_seats_from_another() -> None:
    async with serving(max_clients=4) as (_, port), AsyncExitStack() as stack:
        crowd = [await stack.enter_async_context(Client(port)) for _ in range(4)]
        for client in crowd:
            await client.read(0, 1)
        async with Client(port, "127.0.0.2") as plc, Client(port, "127.0.0.2") as second:
            assert await plc.read(0, 1) == await second.read(0, 1) == [0x5357]
            async with Client(port, "127.0.0.2") as third:  # two of four are its share
                assert await third.closed()
        assert [await client.read(0, 1) for client in crowd[2:]] == [[0x5357], [0x5357]]


async def test_a_reserved_address_always_gets_a_seat_and_keeps_it() -> None:
    async with serving(max_clients=2, reserved=("127.0.0.3",)) as (_, port), AsyncExitStack() as stack:
        for own in ("127.0.0.1", "127.0.0.2"):
            await (await stack.enter_async_context(Client(port, own))).read(0, 1)
        plc = await stack.enter_async_context(Client(port, "127.0.0.3"))
        assert await plc.read(0, 1) == [0x5357]
        for own in ("127.0.0.1", "127.0.0.2", "127.0.0.4"):
            async with Client(port, own):
                pass
        assert await plc.read(0, 1) == [0x5357]


async def test_a_client_that_sends_but_never_reads_is_dropped() -> None:
    async with serving() as (server, port), Client(port) as greedy:
        for _ in range(40_000):  # far more answers than both socket buffers and the limit hold
            greedy.send(request(0, 125))
            if server.health().figures.get("dropped_not_reading", 0) + server.health().figures.get("dropped_flood", 0):
                break
            await asyncio.sleep(0)
        else:
            pytest.fail("never dropped")
        async with Client(port) as good:
            assert await good.read(0, 1) == [0x5357]


async def test_a_block_never_tears() -> None:
    """Both ends of the block carry one number in every read, and the parts belong together."""
    async with serving() as (server, port):

        async def write() -> None:
            for number in range(1, 400):
                await server.publish(snapshot("left", float(number), number), NOW_S)
                await asyncio.sleep(0)

        writer = asyncio.create_task(write())
        async with Client(port) as client:
            torn = 0
            for _ in range(200):
                for address, count in READS:
                    client.send(request(address, count))
                parts = [(await client.answer())[2][2:] for _ in READS]
                block = struct.unpack(f">{TOTAL}H", b"".join(parts))
                if block[2:4] != block[246:248]:
                    torn += 1
                    continue
                (value,) = struct.unpack(">f", struct.pack(">HH", *block[58:60]))
                sequence = block[2] << 16 | block[3]
                assert value == sequence - 1 or sequence == 1  # the first block is written at start
        await writer
        assert torn < 200


async def test_an_address_in_use_is_an_error_that_names_it() -> None:
    async with serving() as (_, port):
        second = RegisterServer(ModbusServer(port=port), {"left": 1})
        with pytest.raises(
            OSError, match=f"cannot listen on 127.0.0.1:{port}: Address already in use: another program"
        ):
            await second.start(NOW_S)
        await second.stop()


async def test_an_address_of_another_computer_is_an_error_that_says_so() -> None:
    server = RegisterServer(ModbusServer(host="192.0.2.1", port=0), {"left": 1})
    with pytest.raises(OSError, match=r"cannot listen on 192\.0\.2\.1:0: .*: expected an address of this computer"):
        await server.start(NOW_S)


async def test_stop_closes_clients_and_frees_the_port() -> None:
    async with serving() as (server, port), Client(port) as client:
        await client.read(0, 1)
        await server.stop()
        assert await client.closed()
        again = RegisterServer(ModbusServer(port=port), {"left": 1})
        assert await again.start(NOW_S) == port
        await again.stop()
