"""Write docs/results.md, the pages in docs/results/ and their picture: no measured figure in them is typed by hand.

A folder of docs/rows/ holds rows of `gloves bench`, packed, and a note.md that says how they came about; a JSON file is
what scripts/measure.py kept of one command. What begins with a task's name stands on the task's page; overview.md is
the first page, with names in braces for its figures.

    python scripts/write_results.py
"""

import argparse
import gzip
import json
import re
from pathlib import Path
from typing import Any

from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.benchmark.matrix_file import read_chosen, read_yaml
from lerobot_gloves.report.beside import OURS, AllBeside, Beside, natural_table
from lerobot_gloves.report.drivers import drivers_table
from lerobot_gloves.report.html_page import svg
from lerobot_gloves.report.markdown import markdown, report_markdown
from lerobot_gloves.report.overall import REFERENCES, Overall, overall_table
from lerobot_gloves.report.paper import COLUMNS, KINDS, published_gain, published_mean, published_wins
from lerobot_gloves.report.plots import overall_plot
from lerobot_gloves.report.summary import Section, summarise
from lerobot_gloves.report.tuned import Pair, share, tuned_table
from lerobot_gloves.specification import NONE
from lerobot_gloves.system.files import whole

DOCS = Path(__file__).parents[1] / "docs"
BENCH = DOCS.parent / "configs" / "bench"
TASKS = {"slalom": "Slalom", "keypad": "Keypad", "can": "CAN", "charger": "Charger Plug"}
OTHERS = "measurements"
PICTURE = "images/results.svg"
FEEG = ("FEEG", "FEEG+gate")
MADE = "This page is written by `python scripts/write_results.py` from `docs/rows/`."


def overview(overall: Overall) -> str:
    """The page that comes first: docs/rows/overview.md with the figures that it asks for."""
    mean = {method: overall.mean(method) for method in COLUMNS}
    paper = {method: published_mean(method) for method in COLUMNS}
    unperturbed = {
        method: [section.results[NONE, method].difference for section in overall.sections] for method in FEEG
    }
    gains = [f"{kind} {overall.gain('IFAE', kind):+.0f} and {published_gain('IFAE', kind):+.0f}" for kind in KINDS]
    return (
        (DOCS / "rows" / "overview.md")
        .read_text()
        .format(
            made=MADE,
            pages=", ".join(f"[{title}](results/{task}.md)" for task, title in TASKS.items()),
            table=markdown(overall_table(overall, searched(overall))),
            cells=len(overall.cells),
            rescaled=overall.rescaled,
            **{
                f"to_{name}": {method: overall.against(method, other) for method in COLUMNS if method not in REFERENCES}
                for name, other in zip(("raw", "csa"), REFERENCES, strict=True)
            },
            mean=mean,
            paper=paper,
            below={method: sum(one.mean < 0 for one in overall.differences(method)) for method in COLUMNS},
            theirs={method: published_wins(method) for method in COLUMNS},
            leads={method: overall.leads(method) for method in COLUMNS},
            gate={"ours": mean["IFAE"] - mean["IFAE+gate"], "paper": paper["IFAE+gate"] - paper["IFAE"]},
            harm=max(-100 * one.mean for one in unperturbed["FEEG"]),
            least=min(100 * one.low for one in unperturbed["FEEG+gate"]),
            **the_copilots(overall),
            further=further(DOCS / "rows" / "keypad_unperturbed"),
            tuned_share=share(pairs := tuned(overall)),
            tuned_tasks=", ".join(TASKS[pair.searched.name] for pair in pairs),
            tuned_table=markdown(tuned_table(pairs)),
            kinds=", ".join(gains),
        )
    )


def the_copilots(overall: Overall) -> dict[str, Any]:
    """The figures of the copilot. Where it was played beside another training of the agent, it has rows of its own."""
    found = AllBeside([Beside(_beside_copilot(section), section) for section in overall.sections])
    kinds = {"short": "stopped early", "few": "few demonstrations"}
    folders = {
        f"{title}, {kind}": DOCS / "rows" / f"{task}_{name}"
        for task, title in TASKS.items()
        for name, kind in kinds.items()
    }
    natural = {title: summarise(read_rows(folder))[0] for title, folder in folders.items() if folder.is_dir()}
    played = {}
    for task in TASKS:
        if (folder := DOCS / "rows" / f"{task}_natural").is_dir():
            played |= {section.name: section for section in summarise(read_rows(folder))}
    others = {title: played[folder.name] for title, folder in folders.items() if folder.name in played}
    return {
        "natural_table": markdown(natural_table(natural, others)),
        "copilot": found,
        "copilot_table": markdown(found.table()),
        "copilot_mean": {method: found.mean(method) for method in (*COLUMNS, OURS)},
        "copilot_ahead": {method: found.ahead(method) for method in COLUMNS},
        "copilot_unperturbed": ", ".join(f"{low:+.1f} ({name})" for name, low in found.lowest_unperturbed.items()),
    }


def further(folder: Path) -> dict[str, str]:
    """By method, success minus the raw agent's in rows of one task with nothing perturbed, as words."""
    (section,) = summarise(read_rows(folder))
    found = {method: section.results[NONE, method].difference for method in section.methods}
    return {
        method: f"{100 * one.mean:+.1f} [{100 * one.low:+.1f}, {100 * one.high:+.1f}]"
        for method, one in found.items()
        if one is not None
    }


def tuned(overall: Overall) -> list[Pair]:
    """What `gloves tune` chose, on the tasks that it was played on, beside what their searches chose."""
    folders = {section.name: DOCS / "rows" / f"{section.name}_tuned" for section in overall.sections}
    played = {name: summarise(read_rows(folder))[0] for name, folder in folders.items() if folder.is_dir()}
    return [Pair(_beside_copilot(one), played[one.name]) for one in overall.sections if one.name in played]


def _beside_copilot(section: Section) -> Section:
    """The rows of a task that were played beside another training of its agent, the copilot's among them, if any."""
    folder = DOCS / "rows" / f"{section.name}_copilot"
    return summarise(read_rows(folder))[0] if folder.is_dir() else section


def searched(overall: Overall) -> dict[str, str]:
    """By method, how many settings a search tried for each task, the fewest and the most; the raw agent has none.

    Raises:
        ValueError: If rows were not played with the settings that the search chose.
    """
    found: dict[str, list[int]] = {method: [] for method in overall.methods if method != COLUMNS[0]}
    for section in overall.sections:
        chosen = read_chosen(str(BENCH.parents[1] / read_yaml(BENCH / f"{section.name}.yaml")["chosen"]))
        chosen = chosen[section.name]["methods"]
        tried = read_yaml(BENCH / f"{section.name}_search.yaml")["tasks"][section.name]["methods"]
        for method, counts in found.items():
            name, _, options = chosen.get(method, {}).get("editor", "").partition(":")
            played = section.methods[method].specification
            if method in chosen and not {name, *options.split(",")} <= set(re.split("[:,+]", played)):
                raise ValueError(f"{section.name}: {method} was played as {played}, but {chosen[method]} was chosen")
            counts.append(len(tried[method]["settings"]) if method in chosen else 0)
    return {
        method: str(counts[0]) if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"
        for method, counts in found.items()
    }


def page(title: str, parts: list[Path]) -> str:
    """A page of rows and measurements."""
    sections = [benchmark(part) if part.is_dir() else measurement(part) for part in parts]
    return "\n\n".join([f"# {title}", f"[Results](../results.md). {MADE}", *sections]) + "\n"


def benchmark(folder: Path) -> str:
    """One folder of benchmark rows, with the note beside it."""
    note = (folder / "note.md").read_text().strip()
    return "\n".join([note, "", report_markdown(read_rows(folder), paper=True).strip()])


def measurement(file: Path) -> str:
    """One command and what it printed."""
    found = json.loads(file.read_text())
    return f"## {found['title']}\n\n```console\n$ {found['command']}\n{found['printed']}\n```"


def drivers(folder: Path) -> str:
    """The page of the scripted drivers: what scripts/study_drivers.py wrote, beside its note."""
    rows: list[dict] = []
    for file in sorted(folder.glob("*.jsonl.gz")):
        rows += map(json.loads, gzip.decompress(file.read_bytes()).decode().splitlines())
    note = (folder / "note.md").read_text().strip()
    return f"# Results of scripted drivers\n\n[Results](../results.md). {MADE}\n\n{note}\n\n{drivers_table(rows)}\n"


def main(output: Path = DOCS) -> None:
    """Write the pages and the picture below a folder."""
    rows = DOCS / "rows"
    overall = Overall([summarise(read_rows(rows / task))[0] for task in TASKS])
    left = sorted(path for path in rows.iterdir() if path.name not in ("overview.md", "drivers"))
    pages = {"results.md": overview(overall), "results/drivers.md": drivers(rows / "drivers")}
    for task, title in TASKS.items():
        mine = [path for path in left if path.name.partition(".")[0].partition("_")[0] == task]
        left = [path for path in left if path not in mine]
        pages[f"results/{task}.md"] = page(f"Results of {title}", mine)
    pages[f"results/{OTHERS}.md"] = page("Other measurements", left)
    pages[PICTURE] = svg(overall_plot(overall), "Success of each method in each cell", page=False) + "\n"
    for name, text in pages.items():
        (output / name).parent.mkdir(parents=True, exist_ok=True)
        with whole(output / name) as file:
            file.write_text(text)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    main()
