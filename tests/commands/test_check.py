"""`gloves check`: its figures against counts by hand and the calibration's, and its verdict."""

import logging
import math
import shutil

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class

from lerobot_gloves.checkpoints.held_out import HeldOutConfig
from lerobot_gloves.checkpoints.on_data import open_adapter
from lerobot_gloves.checkpoints.telling import CLEAN, KINDS, Chunks, spread_out, tell, verdict, went_wrong
from lerobot_gloves.commands import check as check_command
from lerobot_gloves.commands.calibrate import calibrate
from lerobot_gloves.commands.check import check, main
from lerobot_gloves.report.tables import MISSING
from lerobot_gloves.scores import ResidualScore, ReverseScore
from tests.builders import FLOW, save_policy, write_dataset

T, NAN = FLOW["chunk_size"], float("nan")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "tiny", episodes=5, length=15).root


@pytest.fixture(scope="module")
def adapter(tmp_path_factory):
    return save_policy(tmp_path_factory.mktemp("saved") / "adapter", "gloves_expert_flow", seed=7)


def options(folder, data) -> list[str]:
    return [f"--policy.path={folder}", "--dataset.repo_id=me/tiny", f"--dataset.root={data}", "--scores=[reverse]"]


def chunks(clean, wrong, episode=None) -> Chunks:
    n, scores = len(clean), {kind: torch.tensor(wrong).double() for kind in KINDS}
    scores[CLEAN] = torch.tensor(clean).double()
    return Chunks({"reverse": scores}, torch.tensor(episode or [0] * n), torch.zeros(n), torch.empty(n, 0))


def test_areas_and_shares_are_those_counted_by_hand():
    """2.5 lies above two of three, 4 above all, 1 above none and beside one: (2 + 3 + 0.5) / 9."""
    found = chunks([1.0, 2.0, 3.0], [2.5, 4.0, 1.0])
    assert found.area("reverse", "noised") == pytest.approx((5.5 / 9, 0.0, 1.0)), "one episode tells of no other"
    # Of three scores a gate turns away what lies above all of them from alpha 1/4 on, and what above two from 1/2 on.
    assert [found.threshold("reverse", alpha) for alpha in (0.2, 0.25, 0.5)] == [float("inf"), 3.0, 2.0]
    assert [found.stopped("reverse", "noised", alpha) for alpha in (0.2, 0.25, 0.5)] == pytest.approx([0, 1 / 3, 2 / 3])
    unreplayed = chunks([1.0, 2.0, 3.0], [NAN, 4.0, 1.0])
    assert unreplayed.area("reverse", "replayed")[0] == pytest.approx(3.5 / 6)
    assert unreplayed.stopped("reverse", "replayed", 0.25) == 0.5


def test_a_chunk_is_judged_by_the_other_episodes_alone():
    """Episode 1's 9 lies above both of episode 0, whose own larger score says nothing of it."""
    found = chunks([1.0, 2.0, 9.0, 1.5], [0.0] * 4, [0, 0, 1, 1])
    assert found.p_values("reverse").tolist() == pytest.approx([3 / 3, 2 / 3, 1 / 3, 2 / 3])
    assert chunks([1.0, 2.0], [0.0] * 2).p_values("reverse").tolist() == [1.0, 1.0], "one episode has no other"


@pytest.mark.parametrize(
    ("lengths", "most", "expected"),
    [([15, 15], 400, (1, 12)), ([15, 4, 15], 6, (2, 6)), ([10, 9, 100], 12, (7, 14)), ([10], 1, (1, 1))],
)
def test_few_frames_are_all_taken_and_many_spread_out(lengths, most, expected):
    """Of chunks of 10 an episode of 15 has 6 places; one of 100 has 91, of which every seventh is 13."""
    assert spread_out(lengths, 10, most) == expected


def test_for_what_the_data_are_too_few_is_said_before_anything_is_scored(adapter, tmp_path, typed, capsys, monkeypatch):
    root = write_dataset(tmp_path / "few", episodes=4, length=[15, T - 1, T, T]).root
    monkeypatch.setattr(check_command, "check_adapter", lambda *_, **__: pytest.exit("scoring"))
    typed(*options(adapter, root))
    with pytest.raises(pytest.exit.Exception, match="scoring"):
        check()
    line = capsys.readouterr().out.strip().splitlines()[-1]
    assert line == (
        f"{15 - T + 3} chunks of 3 episodes of me/tiny, one every frame (1 episodes are shorter than {T} actions and "
        f"not among them): the smallest alpha of a gate on them is {math.ceil(1e4 / (15 - T + 4)) / 1e4:g} of chunks, "
        "0.25 of episodes"
    )


def test_data_without_a_whole_chunk_are_refused(adapter, tmp_path, typed):
    typed(*options(adapter, write_dataset(tmp_path / "short", episodes=2, length=T - 1).root))
    with pytest.raises(SystemExit) as exit:
        main()
    assert str(exit.value.code) == f"gloves check: no episode is as long as a chunk of the adapter, {T} actions"


def test_the_interval_is_of_episodes_not_of_chunks():
    """Four episodes of a hundred equal chunks say no more than four chunks do."""
    clean, wrong = [0.0, 2.0, 0.0, 2.0], [1.0, 1.0, 3.0, 3.0]
    few = chunks(clean, wrong, [0, 1, 2, 3]).area("reverse", "noised")
    many = chunks(
        [v for v in clean for _ in range(100)],
        [v for v in wrong for _ in range(100)],
        [e for e in range(4) for _ in range(100)],
    ).area("reverse", "noised")
    assert many == pytest.approx(few) and few[1] < few[0] < few[2]


def test_the_verdict_is_that_of_the_best_score_at_its_lower_bound():
    apart = chunks([0.0] * 20, [1.0] * 20, list(range(20)))
    assert verdict(apart) == (
        True,
        "usable: the area between a context's own chunk and another's is 1.00 by reverse, at least 1.00",
    )
    alike = chunks([0.0, 1.0] * 10, [1.0, 0.0] * 10, [row // 2 for row in range(20)])
    usable, line = verdict(alike)
    assert (
        not usable and line.startswith("not usable: ") and "0.50 by reverse, at least 0.50, where 0.6 is needed" in line
    )


def test_what_goes_wrong_does_so_by_as_much_as_it_says():
    chunk, spread = torch.ones(4000, 3, 2), torch.tensor([1.0, 4.0])
    wrong = went_wrong(chunk, 2 * chunk, 3 * chunk, spread, torch.Generator().manual_seed(0))
    assert list(wrong) == list(KINDS)
    torch.testing.assert_close((wrong["noised"] - chunk).std(dim=(0, 1)), 0.5 * spread, rtol=0.05, atol=0)
    assert (wrong["scaled"] == 0.5).all() and (wrong["replayed"] == 2).all() and (wrong["another moment"] == 3).all()
    moved = wrong["shifted"] - chunk
    assert (moved == moved[:, :1]).all(), "whole chunks"
    assert {tuple(one) for one in moved[:, 0].tolist()} == {(1.0, 0.0), (0.0, 4.0)}


@pytest.mark.parametrize("kind", ["gloves_expert_flow", "gloves_copilot"])
def test_clean_chunks_score_as_a_calibration_has_them(kind, data, tmp_path, typed):
    folder = save_policy(tmp_path / "adapter", kind, seed=7)
    typed(
        f"--policy.path={folder}",
        "--dataset.repo_id=me/tiny",
        f"--dataset.root={data}",
        "--stride=1",
        "--scores=[reverse]",
    )
    expected = calibrate()

    config = PreTrainedConfig.from_pretrained(folder)
    config.pretrained_path, config.device = folder, "cpu"
    opened = open_adapter(config, HeldOutConfig("me/tiny", root=str(data)), None)
    found = tell(opened, {"reverse": ReverseScore()}, most=1000, batch_size=8)
    torch.testing.assert_close(
        found.scores["reverse"][CLEAN].sort().values.float(), expected.of("reverse:steps=1", T).sort().values
    )
    assert found.episode.bincount().tolist() == [15 - T + 1] * 5
    replayed = found.scores["reverse"]["replayed"].isnan()
    assert replayed.sum() == 5 * min(T, 15 - T + 1), "an episode's first chunks have none before"


def test_an_untrained_adapter_is_not_usable_and_its_calibration_says_so(adapter, data, typed, capsys, caplog):
    typed(*options(adapter, data))
    calibrate()
    assert any(r.levelname == "WARNING" and r.message.startswith("not usable: ") for r in caplog.records)
    with pytest.raises(SystemExit) as exit:
        main()
    assert exit.value.code == 1
    printed = capsys.readouterr().out
    assert printed.strip().splitlines()[-1].startswith("not usable: ")
    assert "| reverse:steps=1 | 0.05  |" in printed and "of 5 episodes of me/tiny, one every frame" in printed
    assert "| first third of an episode " in printed and "| state 4: state_" in printed


def test_without_an_adapter_there_is_one_line(typed, data):
    typed("--dataset.repo_id=me/tiny", f"--dataset.root={data}")
    with pytest.raises(SystemExit) as exit:
        main()
    assert str(exit.value.code) == "gloves check: --policy.path is missing, a trained checkpoint"


def test_an_adapter_with_other_scores_is_asked_for_these(adapter, data, tmp_path, typed, capsys, monkeypatch):
    kind = get_policy_class("gloves_expert_flow")
    monkeypatch.setattr(kind, "scores", {"residual": ResidualScore})
    monkeypatch.setattr(ReverseScore, "__call__", lambda *_, **__: pytest.fail("it has none"))
    folder = shutil.copytree(adapter, tmp_path / "adapter")
    typed(f"--policy.path={folder}", "--dataset.repo_id=me/tiny", f"--dataset.root={data}", "--scores=[residual]")
    calibrate()
    typed(f"--policy.path={folder}", "--dataset.repo_id=me/tiny", f"--dataset.root={data}")
    with pytest.raises(SystemExit):
        main()
    assert "| residual:times=" in capsys.readouterr().out


def test_what_short_episodes_cannot_show_is_said(adapter, tmp_path, typed, capsys):
    """Of two chunks in a row there is none, so nothing is replayed: no NaN."""
    short = write_dataset(tmp_path / "short", episodes=3, length=2 * T - 2).root
    typed(*options(adapter, short))
    with pytest.raises(SystemExit):
        main()
    printed = capsys.readouterr().out
    assert "nan" not in printed and "no episode is as long as two chunks, so that nothing can be replayed:" in printed
    header, _, first, *_ = [line.split("|") for line in printed.splitlines() if line.startswith("|")]
    replayed = [cell.strip() for cell in header].index("replayed")
    assert first[replayed].strip() == MISSING and first[replayed + 1].strip() != MISSING


def test_ffmpeg_that_is_missing_is_no_page_of_tracebacks(adapter, data, typed, monkeypatch):
    logger = logging.getLogger("lerobot.utils.import_utils")
    monkeypatch.setattr(logger, "filters", [])  # other tests' commands have theirs
    typed(*options(adapter, data))
    with pytest.raises(SystemExit):
        main()
    said = ["'torchcodec' is installed but cannot be loaded (see the error above)", "another one"]
    assert [bool(logger.filter(logging.makeLogRecord({"msg": text}))) for text in said] == [False, True]
