"""What the pages say of the code is true: the table of options, the README's figures and its command."""

import json
import re
import shlex
import subprocess
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest
from lerobot.policies import get_policy_class

import lerobot_policy_gloves  # noqa: F401, registers the adapters
from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.perturbations import PERTURBATIONS
from lerobot_gloves.report.overall import Overall
from lerobot_gloves.report.paper import KINDS
from lerobot_gloves.report.summary import summarise
from lerobot_gloves.scores import SCORES
from scripts.write_results import TASKS, the_copilots
from tests.preloaded import server

ROOT = Path(__file__).parents[1]
ADAPTERS = ("gloves_expert_flow", "gloves_align_flow", "gloves_copilot", "ddpm_assist", "csa_assist")


def test_the_table_of_options_is_that_of_the_classes():
    section = (ROOT / "docs" / "adapters.md").read_text().partition("\n## Options\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (\S+) \| .+ \|$", section, re.MULTILINE)
    editors = {name: editor for kind in ADAPTERS for name, editor in get_policy_class(kind).editors.items()}
    choices = {**editors, **SCORES, **PERTURBATIONS}
    assert len(choices) == len(editors) + len(SCORES) + len(PERTURBATIONS)  # a name says what it is
    expected = [(name, one.name, repr(one.default)) for name, choice in choices.items() for one in fields(choice)]
    assert sorted(rows) == sorted(expected)


def test_the_best_of_what_stands_in_a_line_is_bold_and_the_second_best_italic():
    page = (ROOT / "docs" / "results.md").read_text().partition("## The copilot")[0]
    lines = re.findall(rf"^\| \w+, (?:{'|'.join(KINDS)}) +\|(.*)\|$", page, re.M)
    assert len(lines) == 16
    for line in lines:
        entries = [entry.strip() for entry in line.split("|")]
        found = [float(entry.strip("*_")) for entry in entries]
        best, second = sorted(set(found), reverse=True)[:2]
        assert {f for f, entry in zip(found, entries, strict=True) if entry.startswith("**")} == {best}, line
        assert {f for f, entry in zip(found, entries, strict=True) if entry.startswith("_")} == {second}, line


def test_the_readmes_figures_are_those_of_the_rows():
    overall = Overall([summarise(read_rows(ROOT / "docs" / "rows" / task))[0] for task in TASKS])
    beside = the_copilots(overall)["copilot"]
    readme = (ROOT / "README.md").read_text()
    told = dict(re.findall(r"^\| ([^|]+) \| (\d+\.\d \| \**\d+\.\d)\** \|", readme, re.MULTILINE))
    for name, method in {"IFAE": "IFAE", "CSA, a baseline": "CSA", "FEEG + gate": "FEEG+gate"}.items():
        assert told[name] == f"{overall.mean('agent'):.1f} | {overall.mean(method):.1f}"
    assert told["copilot"] == f"{beside.mean('agent'):.1f} | **{beside.mean('copilot'):.1f}"
    episodes = {sum(result.episodes for result in overall.results(name)) for name in ("agent", "IFAE", "CSA")}
    episodes.add(sum(result.episodes for _, _, result in beside.cells()))
    assert f"A line is {episodes.pop():,} episodes" in readme and not episodes
    others = sum(not task.same_agent for task in beside.tasks)
    assert others == 3 and "On three of the tasks the copilot corrected another training of the agent" in readme


@pytest.mark.slow
def test_the_readmes_command_runs_as_it_stands(tmp_path):
    blocks = re.findall(r"```bash\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    (command,) = [block for block in blocks if "--policy.path=lerobot_gloves/demo/agent" in block]
    assert "<" not in command
    program, *options = shlex.split(
        command.replace("\\\n", "").replace("=48", "=2").replace("outputs/first", str(tmp_path))
    )
    done = subprocess.run([server() / program, *options], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    (task,) = json.loads((tmp_path / "eval_info.json").read_text())["per_task"]
    assert len(task["metrics"]["successes"]) == 2


def test_the_citation_and_the_changelog_know_the_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1] == version
    headings = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[:2] == ["Unreleased", version]
