"""Rows packed into one file read like their own."""

from dataclasses import replace
from pathlib import Path

import pytest

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.folder import PACKED, pack, read_rows
from lerobot_gloves.benchmark.plan import finished_cells
from lerobot_gloves.benchmark.play import make_row
from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.evaluation.episode import Episode
from tests.benchmark.rows import ROWS, loaded, planned, write

RAW, GATED = Cell("none", "none", 0), Cell("noised:sigma=0.005", "feeg:start=0.5", 1, gate=True)


def test_packed_rows_read_like_their_own(tmp_path: Path, setup: Setup) -> None:
    loose, packed = tmp_path / "loose", tmp_path / "packed"
    loose.mkdir()
    for cell in (GATED, RAW, replace(RAW, seed=3)):
        write(loose, setup, cell)
    rows = read_rows(loose)
    file = pack(rows, packed)
    assert file == packed / PACKED and read_rows(packed) == rows
    assert finished_cells(packed, planned(setup, RAW, GATED)) == {RAW, GATED}
    before = file.read_bytes()
    assert pack(read_rows(packed), packed).read_bytes() == before, "the same rows, the same bytes"
    # A cell that is played anew goes before what was packed of it.
    (job,) = planned(setup, RAW)
    make_row(job, seconds=2.0, episodes=[Episode(10000, success=True)]).save(packed)
    assert [row.seconds for row in read_rows(packed) if row.cell == RAW] == [2.0] and len(read_rows(packed)) == 3


def test_packed_rows_are_far_smaller(tmp_path: Path) -> None:
    rows = [replace(row, cell=replace(row.cell, seed=seed)) for seed in range(20) for row in loaded(ROWS)]
    for row in rows:
        row.save(tmp_path)
    loose = sum(file.stat().st_size for file in tmp_path.iterdir())
    assert pack(read_rows(tmp_path), tmp_path / "packed").stat().st_size < loose / 10


@pytest.mark.parametrize("content", [b"", b"no gzip", bytes.fromhex("1f8b0800000000000003ab5600")])
def test_a_damaged_pack_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / PACKED).write_bytes(content)
    with pytest.raises(ValueError, match=r"rows\.jsonl\.gz is not a row of gloves bench"):
        read_rows(tmp_path)
