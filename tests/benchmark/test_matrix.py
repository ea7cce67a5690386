from dataclasses import replace

import pytest

from lerobot_gloves.benchmark.matrix import Method, Setting, Task, cells, select, single_task
from lerobot_gloves.tasks.slalom import SlalomEnv

SHARED = {"split": "test", "episodes": 2, "batch_size": 2}
METHODS = {
    "agent": Method(),
    "FEEG": Method(adapter="expert", editor="feeg:start=0.2"),
    "FEEG+gate": Method(adapter="expert", editor="feeg:start=0.4", gate=True, alpha=0.1, score="reverse:steps=5"),
    "CSA": Method(adapter="csa", editor="csa", options={"adapter_rename_map": {"a": "b"}}),
}
SLALOM = Task(
    env=SlalomEnv(), agent="a", perturbations={"none": "none", "noised": "noised:sigma=0.005"}, methods=METHODS
)
SHORT = replace(
    SLALOM, env=SlalomEnv(episode_length=20), agent="b", perturbations={"slow": "slow"}, methods={"agent": Method()}
)


def test_every_combination_once_with_seeds_outermost() -> None:
    found = list(cells({"slalom": SLALOM, "short": SHORT}, [3, 1, 3], **SHARED))
    names = [str(cell) for _, cell in found]
    each = [f"slalom / {line} / {column}" for line in ("none", "noised") for column in METHODS] + [
        "short / slow / agent"
    ]
    assert names == [f"{name} / seed {seed}" for seed in (3, 1) for name in each]


def test_a_cell_has_what_its_task_and_method_say() -> None:
    found = {
        (cell.task, cell.column): (setup, cell)
        for setup, cell in cells({"slalom": SLALOM, "short": SHORT}, [0], **SHARED)
    }
    setup, cell = found["slalom", "FEEG+gate"]
    assert (cell.perturbation, cell.editor, cell.gate) == ("noised:sigma=0.005", "feeg:start=0.4", True)
    assert (setup.agent, setup.adapter, setup.alpha, setup.score) == ("a", "expert", 0.1, "reverse:steps=5")
    assert (setup.split, setup.episodes, setup.batch_size) == ("test", 2, 2)
    assert (found["slalom", "FEEG"][1].editor, found["slalom", "FEEG"][1].gate) == ("feeg:start=0.2", False)
    assert found["slalom", "CSA"][0].options == {"adapter_rename_map": {"a": "b"}}
    setup, cell = found["short", "agent"]
    assert (setup.agent, setup.adapter, cell.editor) == ("b", None, "none")
    assert setup.env.episode_length == 20


def test_a_task_without_a_file_has_no_labels() -> None:
    tasks = single_task(SlalomEnv(), "a", "b", ["none", "slow"], ["none", "feeg+gate"], score=None, alpha=0.2)
    found = list(cells(tasks, [0], **SHARED))
    assert [str(cell) for _, cell in found] == [
        f"gloves_slalom / {line} / {column} / seed 0" for line in ("none", "slow") for column in ("agent", "feeg+gate")
    ]
    assert all(cell.label == cell.perturbation_label == "" for _, cell in found)
    assert (found[-1][1].editor, found[-1][1].gate, found[-1][0].alpha) == ("feeg", True, 0.2)


def test_select_by_label() -> None:
    tasks = {"slalom": SLALOM, "short": SHORT}
    found = select(tasks, ["noised"], ["agent", "FEEG"])
    assert [str(cell) for _, cell in cells(found, [0], **SHARED)] == [
        "slalom / noised / agent / seed 0",
        "slalom / noised / FEEG / seed 0",
    ]
    assert select(tasks, None, None) == tasks
    with pytest.raises(ValueError, match="no task has a method 'FEG': choose from CSA, FEEG, FEEG\\+gate, agent"):
        select(tasks, None, ["FEG"])
    with pytest.raises(ValueError, match="no task has a perturbation 'noisy': choose from noised, none, slow"):
        select(tasks, ["noisy"], None)


def test_settings_are_tried_under_names_of_their_own() -> None:
    settings = [
        Setting(editor="feeg:start=0.1"),
        Setting(alpha=0.2),
        Setting(editor="feeg:start=0.1", score="s", alpha=0.3),
    ]
    method = replace(METHODS["FEEG+gate"], settings=settings)
    tried = method.tried("FEEG+gate")
    assert list(tried) == [
        "FEEG+gate (feeg:start=0.1)",
        "FEEG+gate (alpha 0.2)",
        "FEEG+gate (feeg:start=0.1, score s, alpha 0.3)",
    ]
    first, second, third = tried.values()
    assert (first.editor, first.gate, first.alpha, first.score) == ("feeg:start=0.1", True, 0.1, "reverse:steps=5")
    assert (second.editor, second.gate, second.alpha, second.score) == ("feeg:start=0.4", True, 0.2, "reverse:steps=5")
    assert (third.editor, third.gate, third.alpha, third.score) == ("feeg:start=0.1", True, 0.3, "s")
    found = [cell.column for _, cell in cells({"slalom": replace(SHORT, methods={"F": method})}, [0], **SHARED)]
    assert found == [name.replace("FEEG+gate (", "F (") for name in tried]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ([Setting(alpha=i / 20) for i in range(13)], "FEEG has 13 settings, but a search tries at most 12"),
        ([Setting(alpha=0.1), Setting(alpha=0.1)], "FEEG has the setting alpha 0.1 twice"),
        ([Setting()], "FEEG has an empty setting"),
    ],
)
def test_settings_that_make_no_search(settings: list[Setting], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Method(settings=settings).tried("FEEG")
