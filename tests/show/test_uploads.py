"""Recordings that are brought to the page: what is taken, what is refused, and that nothing else is touched."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from pathlib import Path

import pytest

from edge_daemon.errors import BadInput
from edge_daemon.show import uploads
from edge_daemon.show.uploads import Uploads

CSV = b"time_s,theta_in_rad,theta_out_rad\n0,0,0\n"
PARQUET = b"PAR1....PAR1"


async def pieces(parts: Iterable[bytes]) -> AsyncIterator[bytes]:
    for part in parts:
        yield part


def left(folder: Path) -> list[Path]:
    """Files anywhere below."""
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.mark.parametrize(("name", "body"), [("a.csv", CSV), ("b-2.parquet", PARQUET), ("c.csv", b"\xef\xbb\xbf" + CSV)])
async def test_a_recording_is_kept_to_the_byte(tmp_path: Path, name: str, body: bytes) -> None:
    box = Uploads(tmp_path / "uploads")
    assert box.files() == {}
    assert await box.take(name, pieces([body[:5], body[5:]])) == len(body)
    assert box.files()[name].read_bytes() == body


@pytest.mark.parametrize(
    ("name", "body", "words"),
    [
        ("../a.csv", CSV, "name"),
        ("..%2fa.csv", CSV, "name"),
        ("/etc/a.csv", CSV, "name"),
        ("a/b.csv", CSV, "name"),
        (".hidden.csv", CSV, "name"),
        ("a.toml", CSV, "name"),
        ("a.csv\n", CSV, "name"),
        ("a.csv\0.toml", CSV, "name"),
        ("", CSV, "name"),
        ("a" * 90 + ".csv", CSV, "name"),
        ("a.csv", b"\xff\xfe\x00", "UTF-8"),
        ("a.csv", b"one word\n", "no rows of numbers"),
        ("a.csv", b"", "no rows of numbers"),
        ("a.csv", b"1,2\0", "no rows of numbers"),
        ("a.parquet", CSV, "Parquet"),
        ("a.parquet", b"PAR1", "Parquet"),
    ],
)
async def test_what_is_no_recording_is_refused_and_leaves_nothing(
    tmp_path: Path, name: str, body: bytes, words: str
) -> None:
    if body == b"PAR1":
        body = b"PAR1 and then something else"
    box = Uploads(tmp_path / "inside" / "uploads")
    with pytest.raises(BadInput, match=words):
        await box.take(name, pieces([body]))
    assert left(tmp_path) == []


async def test_the_size_is_bounded_while_it_arrives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MOST_BYTES", 2**20)
    taken = 0

    async def endless() -> AsyncIterator[bytes]:
        nonlocal taken
        yield CSV
        while True:
            taken += 2**16
            yield b"0" * 2**16

    box = Uploads(tmp_path)
    with pytest.raises(BadInput, match="larger than 1 MiB"):
        await box.take("a.csv", endless())
    assert taken <= 2**20 + 2**16 and left(tmp_path) == []


async def test_a_connection_that_breaks_leaves_nothing_and_does_not_block_the_next(tmp_path: Path) -> None:
    async def broken() -> AsyncIterator[bytes]:
        yield CSV
        raise ConnectionResetError

    box = Uploads(tmp_path)
    with pytest.raises(BadInput, match="cannot be kept"):
        await box.take("a.csv", broken())
    assert left(tmp_path) == []
    await box.take("a.csv", pieces([CSV]))


async def test_older_uploads_make_room(tmp_path: Path) -> None:
    box = Uploads(tmp_path)
    for n in range(uploads.KEPT + 2):
        await box.take(f"r{n}.csv", pieces([CSV]))
    assert len(box.files()) == uploads.KEPT and f"r{uploads.KEPT + 1}.csv" in box.files()
