"""The model card of a flow: what it is for, the command that uses it, what it was trained and calibrated on."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from huggingface_hub import ModelCard, ModelCardData
from lerobot.configs import PreTrainedConfig

from lerobot_gloves.checkpoints.calibration import Calibration, weights_hash
from lerobot_gloves.checkpoints.recommendation import Recommendation

CARD_NAME = "README.md"
MARK = "<!-- Made anew by every calibration; without this line it is left as it is. -->"
CHECKED = "<!-- gloves check of {weights} -->"
"""What begins the section on a check, by the hash of the weights that were checked."""
LEROBOTS = "This policy has been trained and pushed to the Hub using [LeRobot]"
"""What LeRobot's own cards say."""


def policy_card(
    kind: type,
    config: PreTrainedConfig,
    training: Mapping[str, Any],
    calibration: Calibration | None,
    repo_id: str | None,
    checked: str = "",
    recommended: Recommendation | None = None,
) -> ModelCard:
    """The card of a policy whose class says what it is `about`.

    Args:
        kind: The policy's class. One with `editors` is an adapter, and its card shows how a policy is wrapped in it.
        config: The policy's configuration.
        training: The training's configuration as `train_config.json` holds it; empty where it is not known.
        calibration: What its gate was calibrated on; None for nothing.
        repo_id: Where it lies on the Hub; None for a folder.
        checked: The section on a check, with its mark; empty for none.
        recommended: What `gloves tune` chose for it; None for nothing.
    """
    name: str = config.type
    data, adapter = training.get("dataset") or {}, hasattr(kind, "editors")
    own = {"lerobot", "robotics", "gloves", name} | ({"adapter"} if adapter else set())
    if name.startswith("gloves_"):
        own.add("flow-matching")
    header = ModelCardData(
        license=config.license or "apache-2.0",
        library_name="lerobot",
        pipeline_tag="robotics",
        tags=sorted(own.union(config.tags or [])),
        model_name=name,
        datasets=data.get("repo_id"),
    )
    known = {"policy type": f"`{name}`", **_features(config), **_training(training), **kind.facts(config)}  # type: ignore[attr-defined]
    if getattr(kind, "scores", None):
        known["calibration"] = _calibration(calibration)
    about: str = kind.about  # type: ignore[attr-defined]
    parts = [
        f"# {repo_id or name}",
        about,
        _use(kind, config, repo_id or "<this folder>", calibration, recommended) if adapter else _play(repo_id),
        "\n".join(["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in known.items())]),
        *([checked] if checked else []),
    ]
    return ModelCard(f"---\n{header.to_yaml()}\n---\n{MARK}\n\n" + "\n\n".join(parts) + "\n")


def write_card(
    folder: Path,
    policy: Any,
    training: Mapping[str, Any],
    calibration: Calibration | None,
    repo_id: str | None,
    checked: str = "",
    *,
    brief: bool = False,
) -> None:
    """Write the card of a policy into a folder, in the place of one that was made like it.

    Nothing is written for a policy that does not say what it is `about`, as others' do not, nor over a card that
    somebody has written.

    Args:
        folder: Where to.
        policy: The policy.
        training: See `policy_card`.
        calibration: See `policy_card`.
        repo_id: See `policy_card`.
        checked: What a check of it found, as Markdown; if empty, what the card says of these weights stays.
        brief: Whether what the card says of these weights stays in any case, as it says more.
    """
    if not hasattr(policy, "about"):
        return
    file = folder / CARD_NAME
    there = file.read_text() if file.is_file() else MARK
    if MARK in there or LEROBOTS in there:
        mark = CHECKED.format(weights=weights_hash(policy.state_dict()))
        _, known, before = there.partition(mark)
        section = f"{mark}\n## Checked\n\n{checked}" if checked else ""
        if known and (brief or not checked):
            section = mark + before.rstrip()
        recommended = Recommendation.load(folder)
        policy_card(type(policy), policy.config, training, calibration, repo_id, section, recommended).save(file)
    else:
        logging.info("%s is not ours, so it is left as it is", file)


def _use(kind: Any, config: Any, name: str, calibration: Calibration | None, recommended: Recommendation | None) -> str:
    editor = getattr(config, "method", kind.default_editor)
    gated = calibration is not None and editor != "copilot" and recommended is None
    gate = " --policy.gate=true" if gated else ""
    default = f"`{editor}`"
    if recommended is not None:
        default = f"what `gloves tune` recommends, `{' '.join(recommended.flags)}`"
    editors = ", ".join(f"`{editor}`" for editor in kind.editors)
    return f"""It is no policy to be run by itself but an adapter: it corrects yours, whose weights stay as they are.

```bash
lerobot-eval --policy.path=<your policy> --env.type=<your environment> \\
    --policy.wrap=gloves --policy.adapter={name}{gate}
```

`--policy.method` chooses how it edits: {editors}; without it, {default}. The same options work with
`lerobot-rollout` on a robot, once `lerobot_policy_gloves` is installed."""


def _play(repo_id: str | None) -> str:
    return f"""```bash
lerobot-eval --policy.path={repo_id or "<this folder>"} --env.type=<its environment>
```

`lerobot_policy_gloves` must be installed."""


def _features(config: PreTrainedConfig) -> dict[str, str]:
    def shapes(features: Mapping[str, Any] | None) -> str:
        return ", ".join(f"`{key}` {tuple(feature.shape)}" for key, feature in (features or {}).items())

    chunk = f", {config.chunk_size} at a time" if hasattr(config, "chunk_size") else ""
    return {"observations": shapes(config.input_features), "actions": shapes(config.output_features) + chunk}


def _training(training: Mapping[str, Any]) -> dict[str, str]:
    data = training.get("dataset") or {}
    if not data.get("repo_id"):
        return {}
    held_out = f", {100 * data['eval_split']:g} % of its episodes held out" if data.get("eval_split") else ""
    revision = f" at {data['revision']}" if data.get("revision") else ""
    known = {"data": f"`{data['repo_id']}`{revision}{held_out}"}
    if training.get("steps"):
        known["training"] = f"{training['steps']:,} steps of {training['batch_size']} items, seed {training['seed']}"
    return known


def _calibration(calibration: Calibration | None) -> str:
    if calibration is None:
        return "none: `gloves calibrate` makes one, which the gate, `fpas` and `copilot` need"
    scores = ", ".join(f"`{name}`" for name in calibration.scores)
    count = next(iter(calibration.scores.values())).shape[1]
    return f"{scores}, on {count} chunks of {len(calibration.episodes)} episodes of `{calibration.repo_id}`"
