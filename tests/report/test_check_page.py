"""The page of a check: all of it in one file, and the figures of its tables those that were found."""

import re

import torch

from lerobot_gloves.checkpoints.checked import Checked
from lerobot_gloves.checkpoints.regions import Region
from lerobot_gloves.checkpoints.telling import AGENT, BESIDE, CLEAN, KINDS, Chunks
from lerobot_gloves.report.check_page import check_page, check_plot
from lerobot_gloves.report.check_tables import check_card, check_text

N = 40


def checked(agent: bool = False, **options) -> Checked:
    """Clean scores 1 to 40, every wrong kind far above but replays, which are infinite; an agent's just above half."""
    clean = torch.arange(1.0, N + 1).double()
    scores = {CLEAN: clean, **{kind: clean + 1000 for kind in KINDS}}
    scores["replayed"] = torch.full((N,), torch.inf).double()
    scores["replayed"][0] = torch.nan
    scores |= {AGENT: clean + 20, BESIDE: clean} if agent else {}
    episode = torch.arange(N) // 10
    chunks = Chunks({"reverse:steps=1": scores}, episode, torch.zeros(N), torch.empty(N, 0), 4 if agent else 0)
    about = {"adapter": "my/<flow>", "data": "my/data", "losses": (0.5, 1.0), "usable": True, "line": "usable: yes"}
    whole = [Region("first third of an episode", torch.ones(N, dtype=torch.bool))]
    proposals = {"reverse:steps=1": scores[AGENT]} if agent else {}
    return Checked(chunks=chunks, regions=whole, agent="my/agent", proposals=proposals, **about | options)


def test_the_page_needs_nothing_but_itself_and_says_all():
    page = check_page(checked(agent=True))
    assert not re.search(r"(src|href)=\"(?!#)|url\((?!#)|@import", page.replace('xlink:href="#', 'href="#'))
    assert page.count("<svg") == 1 and page.count("<table") == 4
    for text in ("usable: yes", "my/&lt;flow&gt;", "40 chunks of 4 episodes of my/data", "my/agent", "known by heart"):
        assert text in page, text


def test_the_picture_has_a_panel_a_score_and_a_row_a_kind():
    (axes,) = check_plot(checked(agent=True)).axes
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels == ["expert's", *KINDS, "your agent's"]
    written = [text.get_text() for text in axes.texts]
    assert written[0] == "area" and written[1] == "1.00" and written[1 + KINDS.index("replayed")] == "1.00, infinite"
    # 20 higher, a score lies above those of its own place and the 19 after it, and beside the twentieth.
    above = sum(min(20 + place, 40) - 1 * (place < 21) * 0.5 for place in range(1, 41)) / 1600
    assert written[-1] == f"{above:.2f}"
    assert len(check_plot(checked()).axes[0].get_yticklabels()) == 6


def test_tables_hold_what_was_found():
    text = check_text(checked(agent=True))
    # Of forty chunks the gate of 0.05 turns away what is above all but one, that of 0.01 nothing.
    assert re.search(r"\| reverse:steps=1 \| 0.01  \| none +\| 0 % ", text)
    assert re.search(r"\| reverse:steps=1 \| 0.05  \| 39 +\| 100 % ", text)
    # The last episode holds the largest ten: each lies above all thirty others, so has the p-value 1/31.
    assert re.search(r"\| first third of an episode \| 40 +\| 25 % +\| 25 % ", text)
    # Of the agent's, which are 20 larger, 21 of forty lie above 39, and 23 above the 37 of the gate of 0.1.
    assert re.search(r"\| reverse:steps=1 \| agent +\| 0\.\d\d \| 0 % +\| 52 % +\| 57 % +\| 25 +\| 41 +\| 57 ", text)
    assert "agent" not in check_text(checked()) and "loss" not in check_text(checked(losses=None))


def test_what_the_data_have_none_of_is_left_out():
    found = checked()
    found.chunks.scores["reverse:steps=1"]["replayed"][:] = torch.nan
    assert "nan" not in check_text(found) and "| –" in check_text(found)
    (axes,) = check_plot(found).axes
    assert len(axes.texts) == len(KINDS) and "replayed" in [one.get_text() for one in axes.get_yticklabels()]


def test_a_card_has_verdict_and_areas():
    text = check_card(checked())
    assert text.startswith("On 40 chunks of 4 episodes of `my/data`: usable: yes.") and "1.00 [1.00, 1.00]" in text
