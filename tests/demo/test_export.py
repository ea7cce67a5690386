import hashlib
import json
import re

import pytest
import torch
from safetensors.torch import load_file, save_file

from lerobot_gloves.demo.export import describe, export, without_paths
from tests.builders import load, make_policy, observation, save_policy


@pytest.fixture
def checkpoint(tmp_path):
    """An expert flow as `lerobot-train` leaves it: trained and averaged weights differ, paths everywhere."""
    policy = make_policy("gloves_expert_flow")
    with torch.no_grad():
        for parameter in policy.network.parameters():
            parameter.add_(1.0)
    folder = save_policy(tmp_path / "checkpoint", "gloves_expert_flow", policy=policy)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"pretrained_path": str(tmp_path / "before")}))
    training = {
        "dataset": {"repo_id": "me/expert", "root": str(tmp_path / "data"), "eval_split": 0.1},
        "policy": {"pretrained_path": "runs/before", "width": 16},
        "output_dir": "runs/after",
        "checkpoint_path": str(tmp_path / "checkpoint"),
        "extra": [str(tmp_path / "elsewhere"), "kept/relative", 3],
    }
    (folder / "train_config.json").write_text(json.dumps(training))
    return folder


def test_the_exported_flow_is_the_averaged_one(checkpoint, tmp_path):
    export(checkpoint, tmp_path / "small")
    before, (prepare, _) = load(checkpoint)
    after, (prepare_after, _) = load(tmp_path / "small")
    seen = observation(batch=3)
    batch, batch_after = prepare(dict(seen)), prepare_after(dict(seen))
    for key in before.config.input_features:
        assert torch.equal(batch[key], batch_after[key])  # the same statistics
    x, t = torch.randn(3, 6, 2, generator=torch.Generator().manual_seed(0)), torch.tensor([0.1, 0.5, 0.9])
    expected, found = before.velocity(batch)(x, t), after.velocity(batch_after)(x, t)
    torch.testing.assert_close(found, expected, rtol=0, atol=5e-3 * float(expected.abs().max()))
    trained = before.network.bind(batch)(x, t)
    assert (trained - expected).abs().max() > 0.1  # and the trained one is another


def test_the_exported_weights_are_halves_of_the_average_alone(checkpoint, tmp_path):
    export(checkpoint, tmp_path / "small")
    weights, original = load_file(tmp_path / "small" / "model.safetensors"), load_file(checkpoint / "model.safetensors")
    assert set(weights) == {key for key in original if key.startswith("ema.")}
    for key, value in weights.items():
        if original[key].is_floating_point():
            assert value.dtype == torch.float16 and torch.equal(value, original[key].half())
        else:
            assert torch.equal(value, original[key])


def test_what_is_no_weight_stays_exact(tmp_path):
    policy = make_policy("gloves_copilot")
    policy.spread.copy_(torch.tensor([1 / 3, 1e-5]))
    checkpoint = save_policy(tmp_path / "checkpoint", "gloves_copilot", policy=policy)
    export(checkpoint, tmp_path / "small")
    assert torch.equal(load(tmp_path / "small")[0].spread, torch.tensor([1 / 3, 1e-5]))


def test_what_half_precision_cannot_hold_stays_whole(checkpoint, tmp_path):
    weights = load_file(checkpoint / "model.safetensors")
    key = next(key for key in weights if key.startswith("ema.module.") and weights[key].is_floating_point())
    weights[key].flatten()[0] = 70000.0
    save_file(weights, checkpoint / "model.safetensors")
    export(checkpoint, tmp_path / "small")
    exported = load_file(tmp_path / "small" / "model.safetensors")
    assert torch.equal(exported[key], weights[key])
    assert [name for name in exported if exported[name].dtype == torch.float32] == [key]


def test_no_file_tells_where_it_was_made(checkpoint, tmp_path):
    export(checkpoint, tmp_path / "small")
    files = {file.name: file.read_bytes() for file in (tmp_path / "small").iterdir()}
    assert set(files) == {file.name for file in checkpoint.iterdir()}
    for name, content in files.items():
        assert str(tmp_path).encode() not in content and b"runs/" not in content, name
    training = json.loads(files["train_config.json"])
    assert training["dataset"] == {"repo_id": "me/expert", "root": None, "eval_split": 0.1}
    assert training["extra"] == [None, "kept/relative", 3]


def test_without_paths_changes_nothing_else():
    harmless = {"a": [1, 2.5, None, True, "x/y", {"b": "text with / in it"}]}
    assert without_paths(harmless) == harmless


def test_nothing_is_overwritten_or_left_half_done(checkpoint, tmp_path):
    (tmp_path / "small").mkdir()
    with pytest.raises(FileExistsError, match="small exists already"):
        export(checkpoint, tmp_path / "small")
    with pytest.raises(FileNotFoundError, match=r"nothing holds no model\.safetensors: give a pretrained_model folder"):
        export(tmp_path / "nothing", tmp_path / "other")
    foreign = save_policy(tmp_path / "foreign", "act")
    with pytest.raises(ValueError, match=r"holds no averaged weights \(ema\.\*\)"):
        export(foreign, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_the_readme_lists_every_file_with_its_hash(checkpoint, tmp_path):
    export(checkpoint, tmp_path / "small")
    text = describe(tmp_path, ["small"], ["first command", "second command"])
    listed = dict(re.findall(r"^\| `(.+?)` \| \d+ \| `([0-9a-f]{64})` \|$", text, re.MULTILINE))
    files = (tmp_path / "small").iterdir()
    assert listed == {f"small/{file.name}": hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    assert "```bash\nfirst command\nsecond command\n```" in text
