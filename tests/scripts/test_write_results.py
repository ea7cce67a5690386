"""The page of results is what its rows say, to the last figure: nobody has typed into it, nor forgotten to write it."""

from pathlib import Path

from scripts import write_results

RESULTS = Path(__file__).parents[2] / "docs" / "results.md"


def test_the_page_follows_from_the_rows(tmp_path):
    write_results.main(tmp_path / "results.md")
    written, there = (path.read_text().splitlines() for path in (tmp_path / "results.md", RESULTS))
    different = [pair for pair in zip(written, there, strict=False) if pair[0] != pair[1]]
    assert not different, f"run python scripts/write_results.py: {different[0]}"
    assert len(written) == len(there)
