"""`gloves calibrate` on one revision of a Hub repository."""

import pytest
import torch
from huggingface_hub import HfApi, ModelCard

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration
from lerobot_gloves.commands.calibrate import calibrate, main
from tests.builders import save_policy, wrap, write_dataset

REPO = "tester/adapter"


@pytest.fixture
def pushed(online, tmp_path):
    """On main an adapter; on the branch `a`, tagged `v1`, one of other weights, normalisation and guidance."""
    main_, branch = tmp_path / "main", tmp_path / "branch"
    save_policy(main_, "gloves_expert_flow", seed=7, repo_id="tester/elsewhere")
    save_policy(branch, "gloves_copilot", seed=8, guidance=2.0)  # of another type, so nothing of main's fits
    api = HfApi()
    api.create_repo(REPO)
    api.upload_folder(repo_id=REPO, folder_path=main_)
    api.create_branch(REPO, branch="a")
    api.upload_folder(repo_id=REPO, folder_path=branch, revision="a")
    api.create_tag(REPO, tag="v1", revision="a")
    return branch


def options(path, root, *more: str) -> list[str]:
    own = ["--dataset.repo_id=me/tiny", f"--dataset.root={root}", "--scores=[reverse]", "--policy.device=cpu"]
    return [f"--policy.path={path}", *own, *more]


def test_a_revision_is_taken_throughout_and_pushed_to_its_branch(typed, pushed, online, tmp_path):
    root = write_dataset(tmp_path / "data", episodes=3).root
    typed(*options(pushed, root))
    expected = calibrate()
    (pushed / CALIBRATION_NAME).unlink()
    typed(*options(REPO, root, "--policy.pretrained_revision=a", "--push_to_hub=true"))
    calibrate()
    found = Calibration.load(REPO, "a")
    assert torch.equal(found.scores["reverse:steps=1"], expected.scores["reverse:steps=1"])
    assert (found.weights, found.guidance) == (expected.weights, 2.0)
    assert Calibration.load(REPO) is None
    assert list(online.repositories) == [("models", REPO)]
    agent = save_policy(tmp_path / "agent", "act")
    wrap(agent, adapter=REPO, adapter_revision="a", gate=True, alpha=0.5, score="reverse")


def test_of_main_as_before_and_to_where_it_came_from(typed, pushed, online, tmp_path):
    root = write_dataset(tmp_path / "data", episodes=3).root
    typed(*options(REPO, root, "--push_to_hub=true"))
    calibrate()
    assert Calibration.load(REPO) is not None and Calibration.load(REPO, "a") is None


def test_the_card_is_pushed_with_it_unless_somebody_has_written_one(typed, pushed, online, tmp_path):
    root = write_dataset(tmp_path / "data", episodes=3).root
    typed(*options(REPO, root, "--push_to_hub=true"))
    calibrate()
    card = ModelCard.load(REPO)
    assert f"--policy.adapter={REPO}" in card.text and "chunks of 3 episodes of `me/tiny`" in card.text
    repository = online.repositories["models", REPO]
    assert "README.md" not in repository.revisions[repository.branches["a"]]
    HfApi().upload_file(path_or_fileobj=b"# Mine", path_in_repo="README.md", repo_id=REPO)
    calibrate()
    assert repository.files["README.md"] == b"# Mine"
    typed(*options(pushed, root))
    calibrate()
    assert "--policy.adapter=<this folder>" in (pushed / "README.md").read_text()


@pytest.mark.parametrize("revision", ["v1", "commit"])
def test_what_is_no_branch_is_refused_before_anything_runs(typed, pushed, online, tmp_path, revision):
    revision = online.repositories["models", REPO].branches["a"] if revision == "commit" else revision
    line = refusal(typed, REPO, tmp_path / "nowhere", f"--policy.pretrained_revision={revision}", "--push_to_hub=true")
    assert line == (
        f"nothing can be pushed to {revision} of {REPO}, which is no branch: choose from main, a, or download it and "
        "take the folder"
    )


def test_a_revision_that_there_is_not_is_named(typed, pushed, tmp_path):
    line = refusal(typed, REPO, tmp_path / "nowhere", "--policy.pretrained_revision=b", "--push_to_hub=true")
    assert line == f"--policy.path={REPO} at revision b is no checkpoint's folder, nor one on the Hub in reach"


def test_a_folder_without_a_repository_is_not_pushed(typed, pushed, tmp_path):
    line = refusal(typed, pushed, tmp_path / "nowhere", "--push_to_hub=true")
    assert line == f"{pushed} says nothing of a Hub repository to push to: name one by --policy.repo_id"


def refusal(typed, path, root, *more: str) -> str:
    typed(*options(path, root, *more))
    with pytest.raises(SystemExit) as exit:
        main()
    command, _, line = str(exit.value.code).partition(": ")
    assert command == "gloves calibrate" and "\n" not in line
    return line
