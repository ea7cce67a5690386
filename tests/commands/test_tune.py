"""`gloves tune`: what it writes, prints and refuses; its figures are tested beside its criterion."""

import json
import re

import pytest

from lerobot_gloves.checkpoints.card import CARD_NAME
from lerobot_gloves.checkpoints.recommendation import RECOMMENDATION_NAME, Recommendation
from lerobot_gloves.commands.tune import main, tune
from tests.builders import calibrate, save_policy, wrap, write_dataset


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "tiny", episodes=3, length=15).root


def options(folder, data, *more) -> list[str]:
    return [f"--policy.path={folder}", "--dataset.repo_id=me/tiny", f"--dataset.root={data}", "--chunks=6", *more]


def refused(typed, *arguments) -> str:
    typed(*arguments)
    with pytest.raises(SystemExit) as exit:
        main()
    assert "\n" not in exit.value.code
    return exit.value.code


@pytest.mark.parametrize("kind", ["gloves_expert_flow", "gloves_copilot"])
def test_it_prints_flags_and_writes_what_the_wrapper_then_does(kind, data, tmp_path, typed, capsys):
    folder = calibrate(save_policy(tmp_path / "adapter", kind, seed=7))
    own = ["copilot:limit=0.4"] if kind == "gloves_copilot" else []
    tried = ["feeg:start=0.9,steps=1", "fpas:iterations=1,candidates=2", *own]
    typed(*options(folder, data, f"--methods={json.dumps(tried)}", "--most_change=100", "--faults=[noise,scale]"))
    main()
    printed = capsys.readouterr().out
    rows = re.findall(r"^\| ([a-z]\S*) +\| .*\|$", printed, re.MULTILINE)[1:]
    # FEEG ungated and by five levels; the others ask one test, and are gated by it or not; and the agent alone.
    assert f"{1 + 6 + 2 + 2 * len(own)} settings, the chosen one first" in printed and len(rows) <= 10
    assert {row.partition(":")[0] for row in rows} <= {"none", "feeg", "fpas", "copilot"}
    made = Recommendation.load(folder)
    assert printed.strip().splitlines()[-1] == " ".join(made.flags) and made.method == rows[0]
    assert made.chunks >= 6 and made.repo_id == "me/tiny"
    card = (folder / CARD_NAME).read_text()
    assert f"what `gloves tune` recommends, `{' '.join(made.flags)}`" in card
    assert "--policy.gate" not in card.partition("```bash")[2].partition("```")[0], "it is part of what is recommended"
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy")
    settings = wrap(agent, adapter=folder)._corrector.settings
    assert (settings.method, settings.gate, settings.recommended) == (made.method, made.gate, True)


def test_without_a_calibration_no_gate_is_tried(data, tmp_path, typed, capsys, caplog):
    folder = save_policy(tmp_path / "adapter", "gloves_expert_flow", seed=7)
    typed(*options(folder, data, '--methods=["feeg:start=0.9,steps=1"]', "--faults=[noise]"))
    tune()
    assert "is not calibrated, so no gate is tried" in caplog.text
    assert "2 settings, the chosen one first" in capsys.readouterr().out
    assert "nothing to try" in refused(typed, *options(folder, data, '--methods=["fpas"]'))


def test_what_cannot_be_is_one_line_and_nothing_is_written(data, tmp_path, typed):
    folder = save_policy(tmp_path / "adapter", "gloves_expert_flow", seed=7)
    assert "--policy.path is missing, a trained checkpoint" in refused(typed, "--dataset.repo_id=me/tiny")
    assert "me/gone is no folder" in refused(typed, *options("me/gone", data))
    assert "there is no fault 'flood'" in refused(typed, *options(folder, data, "--faults=[flood]"))
    assert "chunks is 0" in refused(typed, *options(folder, data, "--chunks=0"))
    assert "there is no log" in refused(typed, *options(folder, data, f"--log={tmp_path / 'gone'}"))
    assert "unknown method 'drift'" in refused(typed, *options(folder, data, "--methods=[drift]"))
    (tmp_path / "log").write_text('{"length": 2, "scores": {"residual": 1.0}}')
    assert "is not calibrated" in refused(typed, *options(folder, data, f"--log={tmp_path / 'log'}"))
    assert "no healthy chunk" in refused(typed, *options(calibrate(folder), data, f"--log={tmp_path / 'log'}"))
    assert not (folder / RECOMMENDATION_NAME).exists()
