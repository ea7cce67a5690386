import sys
from dataclasses import replace
from pathlib import Path

import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_gloves import commands
from lerobot_gloves.commands.record import RecordConfig, RecordedDatasetConfig, main, record
from lerobot_gloves.recording import staging
from lerobot_gloves.system.locks import Lock
from lerobot_gloves.tasks.slalom import SlalomEnv
from tests.builders import save_policy
from tests.hub import Hub


def config(root: Path, num_episodes=2, env=None, **options) -> RecordConfig:
    named = RecordedDatasetConfig(repo_id="me/slalom", root=root, num_episodes=num_episodes, **options)
    return RecordConfig(env=env or SlalomEnv(), dataset=named)


def typed_to_record(root: Path, num_episodes: int, *options: str) -> list[str]:
    named = ["--env.type=gloves_slalom", "--dataset.repo_id=me/slalom", f"--dataset.root={root}"]
    return ["record", *named, f"--dataset.num_episodes={num_episodes}", *options]


def test_a_complete_dataset_is_never_overwritten(tmp_path):
    root = tmp_path / "slalom"
    record(config(root))
    before = {file: file.read_bytes() for file in root.rglob("*") if file.is_file()}
    assert list(tmp_path.iterdir()) == [root]  # nothing is left of the staging
    for asked in (config(root), config(root, num_episodes=5)):
        with pytest.raises(FileExistsError, match=r"slalom already holds a complete dataset of 2 episodes"):
            record(asked)
    assert before == {file: file.read_bytes() for file in root.rglob("*") if file.is_file()}


def test_two_commands_never_make_the_same_dataset(tmp_path):
    root = tmp_path / "new" / "slalom"
    root.parent.mkdir()
    other = Lock(root.with_name("slalom.lock"))
    assert other.acquire()
    with pytest.raises(BlockingIOError, match=f"another gloves record is making {root}: wait for it, or choose"):
        record(config(root))
    assert [path.name for path in root.parent.iterdir()] == ["slalom.lock"]
    other.release()
    record(config(root))
    assert [path.name for path in root.parent.iterdir()] == ["slalom"]


def test_a_folder_with_other_files_is_left_alone(tmp_path):
    (tmp_path / "slalom").mkdir()
    (tmp_path / "slalom" / "thesis.tex").write_text("years of work")
    with pytest.raises(FileExistsError, match="slalom holds other files"):
        record(config(tmp_path / "slalom"))


def test_staged_episodes_are_kept_and_other_settings_refused(tmp_path, monkeypatch):
    root = tmp_path / "slalom"
    saved = []
    save = staging.save

    def save_and_die(folder, index, episode):
        save(folder, index, episode)
        saved.append(index)
        if len(saved) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(staging, "save", save_and_die)
    with pytest.raises(KeyboardInterrupt):
        record(config(root, 3))
    with pytest.raises(ValueError, match="recorded with mode=None"):
        record(config(root, 3, env=SlalomEnv(mode="0 0 0")))
    record(config(root, 3))
    assert saved == [0, 1, 2]
    assert LeRobotDataset("me/slalom", root=root).num_episodes == 3


def test_an_interrupted_upload_is_all_that_is_left_to_do(tmp_path, monkeypatch):
    root = tmp_path / "slalom"
    pushed = []

    def push(root, **options):
        pushed.append(options)
        if len(pushed) == 1:
            raise ConnectionError
        return "there"

    monkeypatch.setattr("lerobot_gloves.recording.dataset.push", push)
    with pytest.raises(ConnectionError):
        record(config(root, push_to_hub=True, private=True))
    monkeypatch.setattr("lerobot_gloves.recording.demonstrations.record", None)  # nobody records again
    record(config(root, push_to_hub=True, private=True))
    assert pushed == [{"repo_id": "me/slalom", "private": True}] * 2
    assert not staging.staging_folder(root).exists()


def test_the_command_on_the_card_records_the_same(tmp_path):
    asked = config(tmp_path / "slalom", num_episodes=24, env=SlalomEnv(mode="0 0 1", image_size=64))
    assert asked.command == (
        "gloves record --env.type=gloves_slalom --env.image_size=64 --env.mode='0 0 1' "
        "--dataset.repo_id=me/slalom --dataset.num_episodes=24 --seed=30000"
    )


def test_the_command_on_an_agents_card_records_the_same(tmp_path):
    asked = config(tmp_path / "slow", num_episodes=24)
    asked = replace(asked, agent="me/agent", perturbation="slow:alpha=0.5", batch_size=12, seed=None)
    assert asked.command == (
        "gloves record --env.type=gloves_slalom --dataset.repo_id=me/slalom --dataset.num_episodes=24 "
        "--agent=me/agent --perturbation=slow:alpha=0.5 --batch_size=12 --seed=40000"
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"perturbation": "slow"}, "perturbation 'slow' needs --agent: the expert is never perturbed"),
        ({"agent": "me/agent", "batch_size": 101}, "batch_size must lie between 1 and 100, not 101"),
        ({"agent": "/no/thing"}, "--agent=/no/thing is no checkpoint's folder"),
        (
            {"agent": "/no/thing", "perturbation": "nosied"},
            "unknown perturbation 'nosied': choose from chatter, deadzone",
        ),
        (
            {"agent": "me/agent", "perturbation": "rotated"},
            "perturbation 'rotated' cannot be recorded, .*none, noised,",
        ),
        ({"agent": "me/agent", "perturbation": "slow+laggy:p=1"}, r"perturbation 'slow\+laggy:p=1' cannot be recorded"),
        ({"num_workers": 0}, "num_workers must be at least 1, not 0"),
    ],
)
def test_bad_options_of_an_agent_are_named(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        record(replace(config(tmp_path / "slalom"), seed=None, **options))
    assert not (tmp_path / "slalom").exists()


@pytest.fixture
def agent(tmp_path):
    return str(save_policy(tmp_path / "agent", "gloves_flow_policy"))


def test_an_agents_episodes_are_kept_and_other_settings_refused(tmp_path, agent, monkeypatch):
    root = tmp_path / "noised"
    asked = replace(config(root, 5, env=SlalomEnv(episode_length=10)), agent=agent, perturbation="noised", seed=None)
    asked = replace(asked, batch_size=2)
    saved = []
    save = staging.save

    def save_and_die(folder, index, episode):
        save(folder, index, episode)
        saved.append(index)
        if len(saved) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(staging, "save", save_and_die)
    with pytest.raises(KeyboardInterrupt):
        record(asked)
    for change, told in (({"perturbation": "slow"}, "perturbation=noised:sigma=0.005"), ({"agent": None}, "agent=")):
        other = replace(asked, **{"perturbation": "none"} | change, seed=40000)
        with pytest.raises(ValueError, match=f"recorded with .*{told}"):
            record(other)
    record(asked)
    assert saved == [0, 1, 2, 2, 3, 4], "the batch in flight is played again, the one before it is not"
    assert LeRobotDataset("me/slalom", root=root).num_episodes == 5
    assert not staging.staging_folder(root).exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"repo_id": "slalom"}, "must look like user/name, not 'slalom'"),
        ({"repo_id": "a/b/c"}, "must look like user/name, not 'a/b/c'"),
        ({"repo_id": "a/b", "num_episodes": 0}, "dataset.num_episodes must be at least 1, not 0"),
        ({"repo_id": "a/b", "seed": -3}, "seed must not be negative, not -3"),
    ],
)
def test_bad_options_are_named(options, message):
    seed = options.pop("seed", None)
    with pytest.raises(ValueError, match=message):
        RecordConfig(env=SlalomEnv(), dataset=RecordedDatasetConfig(**options), seed=seed)


def test_the_command_lists_its_commands_and_refuses_others(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["gloves", "--help"])
    commands.main()
    listed = capsys.readouterr().out
    assert all(name in listed for name in ("record", "calibrate", "bench"))
    monkeypatch.setattr(sys, "argv", ["gloves", "rekord"])
    with pytest.raises(SystemExit, match="no command 'rekord': choose one of record"):
        commands.main()


def test_a_recording_is_pushed_with_its_card_and_loads_from_the_hub(tmp_path, online: Hub, typed):
    _, *options = typed_to_record(tmp_path / "slalom", 2, "--dataset.push_to_hub=true", "--dataset.private=true")
    typed(*options)
    main()
    repository = online.repositories["datasets", "me/slalom"]
    assert repository.private and repository.tags == {"v3.0": repository.head}
    assert b"# Slalom demonstrations" in repository.files["README.md"]
    loaded = LeRobotDataset("me/slalom", root=tmp_path / "elsewhere")
    assert (loaded.num_episodes, loaded[0]["observation.goal"].shape) == (2, (9,))


def test_a_task_has_as_many_demonstrations_as_in_the_paper(tmp_path):
    asked = config(tmp_path / "slalom", num_episodes=None)
    assert asked.num_episodes == 400 and "num_episodes" not in asked.command
    more = replace(asked, env=type("More", (SlalomEnv,), {"demonstrations": 450})())
    assert more.num_episodes == 450
    assert replace(more, agent="me/agent").num_episodes == 400
