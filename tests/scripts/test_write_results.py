"""The pages of results are what their rows say, to the last figure: none is typed into, none out of date."""

from pathlib import Path
from types import SimpleNamespace

import matplotlib
import pytest

from scripts import write_results

DOCS = Path(__file__).parents[2] / "docs"


def test_the_pages_follow_from_the_rows(tmp_path):
    with matplotlib.rc_context():  # what other tests have imported may draw with other fonts and sizes
        matplotlib.rcdefaults()
        write_results.main(tmp_path)
    pages = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    assert len(pages) == 1 + len(write_results.TASKS) + 1 + 1 + 1, (
        "overview, tasks, drivers, other measurements, picture"
    )
    for page in pages:
        written, there = ((folder / page).read_text().splitlines() for folder in (tmp_path, DOCS))
        different = [pair for pair in zip(written, there, strict=False) if pair[0] != pair[1]]
        assert not different, f"run python scripts/write_results.py: {page}: {different[0]}"
        assert len(written) == len(there), page
    assert {path.name for path in (DOCS / "results").iterdir()} == {p.name for p in pages if p.parent.name == "results"}


def test_the_first_page_is_one_that_a_person_reads():
    assert len((DOCS / "results.md").read_text().splitlines()) <= 150


def played(**specifications):
    """Slalom's columns, as if they had been played with these settings."""
    methods = {name: SimpleNamespace(specification=text) for name, text in specifications.items()}
    return SimpleNamespace(methods=list(methods), sections=[SimpleNamespace(name="slalom", methods=methods)])


def test_a_search_is_told_of_only_where_its_choice_was_played():
    """Slalom's search chose ddpm:gamma=0.3 of twelve, and has no copilot."""
    known = played(agent="none", DDPM="ddpm:gamma=0.3,other=1", copilot="copilot:limit=0.4")
    assert write_results.searched(known) == {"DDPM": "12", "copilot": "0"}
    with pytest.raises(ValueError, match=r"slalom: DDPM was played as ddpm:gamma=0.35, but .*gamma=0\.3"):
        write_results.searched(played(DDPM="ddpm:gamma=0.35"))
