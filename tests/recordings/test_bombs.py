"""Small files that would unpack to more than there is: refused in one line by what they say of their size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from edge_daemon.recordings.csv_file import MOST_CSV_BYTES, MOST_NUMBERS, RecordingError
from edge_daemon.recordings.recording import read_recording

BLOCK = 2**20


def refused(path: Path) -> str:
    before = pa.total_allocated_bytes()
    pool = pa.default_memory_pool()
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    assert pa.total_allocated_bytes() - before < BLOCK and pool.bytes_allocated() < 2**28
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_small_parquet_file_of_many_rows_is_not_unpacked(tmp_path: Path) -> None:
    file, names = tmp_path / "bomb.parquet", ("time_s", "theta_in_rad", "theta_out_rad", "torque_out_Nm")
    block = pa.table(dict.fromkeys(names, np.zeros(BLOCK)))
    with pyarrow.parquet.ParquetWriter(file, block.schema, compression="zstd") as writer:
        for _ in range(MOST_NUMBERS // len(names) // BLOCK + 1):
            writer.write_table(block)
    del block
    assert file.stat().st_size < 2**20
    assert "rows of 4 columns: expected at most" in refused(file)


def test_a_parquet_column_of_text_is_refused_before_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / "text.parquet"
    pyarrow.parquet.write_table(pa.table({"time_s": [0.0, 1.0], "note": ["a" * 2**26, "b"]}), file)
    assert "column note: holds string: expected numbers" in refused(file)


def test_a_header_of_many_names_and_an_endless_file_are_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "wide.csv").write_text("time_s," + ",".join(f"c{i}" for i in range(200_000)) + "\n")
    assert "200001 columns: expected at most" in refused(tmp_path / "wide.csv")
    with (tmp_path / "long.csv").open("wb") as file:
        file.write(b"time_s,theta_in_rad\n")
        file.truncate(MOST_CSV_BYTES + 1)
    assert "cut it in pieces" in refused(tmp_path / "long.csv")
    few = b"t" + b",c" * 999 + b"\n"
    (tmp_path / "dense.csv").write_bytes(b"time_s," + b",".join(b"c%d" % i for i in range(999)) + b"\n" * 70_000)
    assert len(few) and "rows of 1000 columns" in refused(tmp_path / "dense.csv")
