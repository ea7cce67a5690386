"""The page stands on its own, and its plots show the figures of the tables."""

import re
import xml.etree.ElementTree as ElementTree
from copy import deepcopy
from html.parser import HTMLParser
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure

from lerobot_gloves.evaluation.histogram import edge
from lerobot_gloves.report.html_page import report_html
from lerobot_gloves.report.paper import COLUMNS
from lerobot_gloves.report.plots import (
    COLOURS,
    EDITED,
    INK,
    LEFT,
    fidelity_plot,
    plots,
    score_plot,
    success_plot,
)
from lerobot_gloves.report.statistics import wilson
from lerobot_gloves.report.summary import Section, summarise
from tests.benchmark.rows import ROWS, labelled, loaded, row

SCORED = [
    row("noised", "none", 0, [0, 1, 0, 0]),
    row(
        *("noised", "feeg+gate", 0, [1, 1, 0, 0]),
        chunks=4,
        edited=1,
        distance=0.5,
        scores_left={"20": 2, "22": 1},
        scores_edited={"31": 1},
    ),
]


def section(rows: list[dict[str, Any]]) -> Section:
    (made,) = summarise(loaded(rows))
    return made


def points(figure: Figure, panel: int = 0) -> list[tuple[float, float, float, float]]:
    """x, y and the ends of the interval of what is plotted with one."""
    found = []
    for container in figure.axes[panel].containers:
        assert isinstance(container, ErrorbarContainer)
        line, _, (bars,) = container.lines
        ((_, low), (_, high)) = bars.get_segments()[0]
        found.append((float(line.get_xdata()[0]), float(line.get_ydata()[0]), float(low), float(high)))
    return found


@pytest.fixture(scope="module")
def page() -> str:
    return report_html(loaded(SCORED), paper=True)


def test_the_page_needs_nothing_else(page: str) -> None:
    assert not re.search(r'(?:src|href)="(?!#)', page.replace("xlink:href", "href"))
    assert "@import" not in page and "url(http" not in page and "<script" not in page
    assert len(page.encode()) < 1_000_000
    assert page == report_html(loaded(deepcopy(SCORED)), paper=True), "the same rows make the same page"


def test_the_page_is_well_formed(page: str) -> None:
    images = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    assert len(images) == 3
    for image in images:
        ElementTree.fromstring(image.replace("xlink:href", "href"))
    referred = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', page)) - {"section-0"}
    defined = re.findall(r' id="([^"]+)"', page)
    assert referred <= set(defined)

    class Balanced(HTMLParser):
        stack: list[str] = []

        def handle_starttag(self, tag: str, attrs: object) -> None:
            if tag not in ("meta", "wbr"):
                self.stack.append(tag)

        def handle_endtag(self, tag: str) -> None:
            assert self.stack.pop() == tag

    parser = Balanced()
    parser.feed(re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL))
    assert parser.stack == []


def test_the_plots_take_over_the_pages_text_colour(page: str) -> None:
    assert INK not in page
    assert page.count("currentColor") > 20
    assert "prefers-color-scheme: dark" in page
    assert "#000000" not in page, "black text would vanish on a dark screen"


def test_marks_and_names() -> None:
    page = report_html(loaded([SCORED[0], labelled(SCORED[1], label="a<b & c")]))
    assert re.search(r'class="best">50.0<small>\[[0-9.]+, [0-9.]+\]</small></td>', page)
    assert '<th scope="col">a&lt;b &amp; c</th>' in page and "a<b" not in page


class Laid(HTMLParser):
    """What of a page's text stands inside elements that scroll sideways, and what outside."""

    def __init__(self, page: str):
        super().__init__()
        self.depth, self.inside, self.outside = 0, "", ""
        self.feed(re.sub(r"<(style|svg).*?</\1>", "", page, flags=re.DOTALL))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.depth += tag == "div" and (bool(self.depth) or ("class", "wide") in attrs)

    def handle_endtag(self, tag: str) -> None:
        self.depth -= tag == "div" and bool(self.depth)

    def handle_data(self, data: str) -> None:
        if self.depth:
            self.inside += data
        else:
            self.outside += data


def test_wide_tables_scroll_below_captions_that_do_not(page: str) -> None:
    """A caption wraps; the names of the lines stay where they are; every line but an entry's first is small."""
    laid = Laid(page)
    for caption in ("Success in %: mean [95 % Wilson", "Success minus the raw agent's", "How episodes failed"):
        assert caption in laid.outside and caption not in laid.inside
    assert "feeg+gate" in laid.inside
    (sticky,) = [rule for rule in re.findall(r"[^{}]+\{[^{}]*\}", page) if "position: sticky" in rule]
    assert sticky.strip().startswith("tr > :first-child {") and "left: 0" in sticky and "background: var(--" in sticky
    assert page.count('<th scope="row">') == page.count("<tr>") - page.count("<thead>")
    assert re.search(r"<td>\+25\.0<small>\[.*?\]</small><small>p = 1\.000</small></td>", page)
    assert "<td>25.0 %<small>0.500</small></td>" in page


def test_no_two_things_have_one_colour() -> None:
    """Gated methods have their editor's, and are told apart by the marker."""

    def apart(one: str, other: str) -> float:
        return float(np.linalg.norm(np.subtract(to_rgb(one), to_rgb(other))))

    methods = {colour: name for name, colour in zip(COLUMNS, COLOURS, strict=True)}
    assert len(methods) == 6
    everything = [*methods, LEFT, EDITED]
    assert min(apart(one, other) for one, other in combinations(everything, 2)) > 0.2


def test_success_plot_shows_rates_and_intervals() -> None:
    rates = {
        (round(y, 6), round(low, 3), round(high, 3))
        for _, y, low, high in points(success_plot(section(ROWS), paper=False))
    }
    expected = set()
    for successes, episodes in ((4, 4), (2, 8), (5, 8)):
        low, high = wilson(successes, episodes)
        expected.add((100 * successes / episodes, round(100 * low, 3), round(100 * high, 3)))
    assert rates == expected


def test_the_papers_figures_are_plotted_where_the_strength_is_the_same() -> None:
    def crosses(perturbation: str) -> list[float]:
        figure = success_plot(section([row(perturbation, "none", 0, [0, 1, 0, 0])]), paper=True)
        return [float(line.get_ydata()[0]) for line in figure.axes[0].lines if line.get_marker() == "x"]

    assert crosses("laggy:p=0.2") == pytest.approx([38.7])
    assert crosses("laggy:p=0.6") == []


def test_fidelity_plot_shows_distance_against_success() -> None:
    figure = fidelity_plot(section(SCORED))
    assert sorted((x, y) for x, y, _, _ in points(figure)) == [(0.0, 25.0), (0.5, 50.0)]


def test_score_plot_stacks_shares_of_all_chunks() -> None:
    """16 chunks: 8 left in bin 20, 4 in bin 22, 4 edited in bin 31."""
    left, both = [patch.get_data() for patch in score_plot(section(SCORED)).axes[0].patches]
    assert left.edges[0] == pytest.approx(edge(20)) and left.edges[-1] == pytest.approx(edge(32))
    assert len(left.edges) == len(left.values) + 1
    assert list(left.values) == [50, 0, 25] + [0] * 9
    assert list(both.values) == [50, 0, 25] + [0] * 8 + [25]
    assert list(both.baseline) == list(left.values)


@pytest.mark.parametrize("bins", [{"0": 1, "9": 2}, {"-12": 1, "0": 1, "30": 2}, {"-40": 2, "-1": 1}])
def test_scores_of_0_and_below_are_plotted(bins: dict[str, int]) -> None:
    rows = deepcopy(SCORED)
    for episode in rows[1]["episodes"]:
        episode.update(scores_left=bins, scores_edited={})
    axes = score_plot(section(rows)).axes[0]
    left = axes.patches[0].get_data()
    assert sum(left.values) == pytest.approx(100)
    low, high = axes.get_xlim()
    assert low <= left.edges[0] < left.edges[-1] <= high and all(np.diff(left.edges) > 0)
    assert len(axes.get_xticks()) < 12


def test_a_search_is_not_plotted() -> None:
    rows = [row("slow", f"feeg:start=0.{i}", 0, [0, 1, 0, 1]) for i in range(13)]
    assert plots(section(rows)) == {}
    assert "No plots: 13 methods" in report_html(loaded(rows)) and "<svg" not in report_html(loaded(rows))


def test_plots_without_anything_to_show_are_left_out() -> None:
    assert len(plots(section(SCORED))) == 3
    assert len(plots(section(ROWS))) == 2, "no scores"
    assert len(plots(section(ROWS[2:]))) == 1, "no chunks"
