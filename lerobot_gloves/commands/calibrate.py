"""`gloves calibrate`: score episodes that went well with a trained adapter, so that its gate knows what is normal."""

import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig, parser

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration, weights_hash
from lerobot_gloves.checkpoints.card import write_card
from lerobot_gloves.checkpoints.held_out import HeldOutConfig
from lerobot_gloves.checkpoints.hub import push, pushed_to
from lerobot_gloves.checkpoints.on_data import named_adapter, open_adapter
from lerobot_gloves.checkpoints.scoring import Decisions, default_lengths, score_dataset
from lerobot_gloves.checkpoints.telling import tell, verdict
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.commands.start import start
from lerobot_gloves.faults import PROMPT
from lerobot_gloves.recording.sources import expert_episodes, healthy_episodes
from lerobot_gloves.scores import ReverseScore
from lerobot_gloves.scores.score import needs_posterior
from lerobot_gloves.specification import parse_all, specification

CHUNKS_OF = ("expert", "agent", "person")
CHECKED = 200
"""About how many chunks a first look at the adapter takes, by one score; `gloves check` takes more, and says more."""


@dataclass
class CalibrateConfig:
    """Score held-out expert episodes with a trained adapter and keep the scores beside its weights.

    gloves calibrate --policy.path=CHECKPOINT --dataset.repo_id=EXPERT

    Or score what an agent proposed where it succeeded, as gloves record --agent=AGENT writes it:

    gloves calibrate --policy.path=CHECKPOINT --dataset.repo_id=PROPOSALS --chunks_of=agent

    Or, for gloves drive and gloves teleoperate, what a person with keys would have commanded at the expert's moments:

    gloves calibrate --policy.path=CHECKPOINT --dataset.repo_id=EXPERT --chunks_of=person
    """

    # The episodes; --dataset.episodes picks some. By default, of the dataset that the adapter was trained on, those
    # that --dataset.eval_split held out of training, and of another dataset all. Root, revision, video_backend and
    # depth_output_unit are the training's unless they are named.
    dataset: HeldOutConfig
    # Whose chunks are taken of it: the expert's; agent, those of an unperturbed agent's successes; or person, the
    # expert's as keys would have commanded them, one of eight directions, held for a chunk.
    chunks_of: str = "expert"
    # The adapter: --policy.path= a checkpoint's folder, or a Hub id with --push_to_hub=true.
    policy: PreTrainedConfig | None = None
    # Nonconformity scores to calibrate, with their options: reverse, residual, likelihood or selfnormalised for a flow,
    # for a copilot correction as well. By default reverse with 1, 2, 5 and 10 steps, and what the adapter's gate asks.
    scores: list[str] | None = None
    # Every how many frames of an expert's episode a chunk begins; an agent's begin where it was asked.
    stride: int = 5
    # How many actions the agents' proposals have, as in [15, 50]. By default every number up to the adapter's chunk, of
    # chunks of more than 20 the whole, the half, the quarter and 1. A proposal between two of them is judged by as many
    # of its actions as the smaller one says.
    lengths: list[int] | None = None
    # How far the time stamps of frames may be off, in seconds; by default what the training allowed.
    tolerance_s: float | None = None
    # Chunks scored at once.
    batch_size: int = 64
    # Whether to add the calibration to the checkpoint's Hub repository, to the branch --policy.pretrained_revision.
    push_to_hub: bool = False

    def __post_init__(self) -> None:
        if self.chunks_of not in CHUNKS_OF:
            raise ValueError(f"unknown chunks_of {self.chunks_of!r}: choose from {', '.join(CHUNKS_OF)}")
        if self.scores == []:
            raise ValueError("scores is empty: name at least one, such as reverse:steps=1")
        if self.lengths is not None and min(self.lengths, default=0) < 1:
            raise ValueError(f"lengths is {self.lengths}, but must hold numbers of at least 1")
        for name in ("stride", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, but must be at least 1")
        path = parser.get_path_arg("policy")
        if path and not Path(path).is_dir() and not self.push_to_hub:
            raise ValueError(
                f"{path} is no folder: download the checkpoint and give its folder, "
                "or add --push_to_hub=true to calibrate it on the Hub"
            )
        self.policy = named_adapter()

    @classmethod
    def __get_path_fields__(cls) -> list[str]:
        return ["policy"]


@parser.wrap()
def calibrate(cfg: CalibrateConfig) -> Calibration:
    """Run `gloves calibrate`."""
    assert cfg.policy is not None
    path, revision = str(cfg.policy.pretrained_path), cfg.policy.pretrained_revision
    repo_id = pushed_to(cfg.policy) if cfg.push_to_hub else None
    opened = open_adapter(cfg.policy, cfg.dataset, cfg.tolerance_s)
    adapter, meta = opened.adapter, opened.meta
    if cfg.chunks_of == "agent":
        episodes, length = healthy_episodes(opened.episodes, meta)
    else:
        episodes, length = expert_episodes(opened.episodes, meta), None
    weights = weights_hash(adapter.state_dict())
    named = cfg.scores or default_scores(adapter)
    asked = [score for text in named for score in parse_all(text, adapter.scores, "score")]
    scores = {specification(score, adapter.scores): score for score in asked}
    ends = [int(meta.episodes["length"][episode]) for episode in episodes]
    decisions = _decisions(adapter, cfg, length, max(ends), any(map(needs_posterior, asked)))
    dataset = opened.frames(episodes, decisions.indices)
    keys = PROMPT if cfg.chunks_of == "person" else None
    table, episode_of = score_dataset(adapter, opened.preprocess, dataset, scores, decisions, cfg.batch_size, keys)
    calibration = Calibration(
        scores=table,
        repo_id=opened.data.repo_id,
        revision=str(opened.data.revision or meta.revision),
        episodes=tuple(episodes),
        weights=weights,
        guidance=getattr(cfg.policy, "guidance", 1.0),
        episode_of=tuple(episode_of),
        lengths=tuple(decisions.lengths),
    )
    line = ""
    if cfg.chunks_of != "agent" and decisions.length == adapter.config.chunk_size:
        opened, five = replace(opened, episodes=episodes), {"reverse:steps=5": ReverseScore(steps=5)}
        look = five if "reverse" in adapter.scores else scores
        usable, line = verdict(tell(opened, look, CHECKED, cfg.batch_size, kinds=["another moment"]))
        logging.log(logging.INFO if usable else logging.WARNING, "%s", line)
    counts = len(episode_of), len(set(episode_of))

    def write(folder: Path) -> None:
        calibration.save(folder)
        write_card(folder, adapter, opened.trained, calibration, repo_id, line, brief=True)

    if Path(path).is_dir():
        write(Path(path))
        logging.info("%d chunks of %d episodes -> %s", *counts, Path(path) / CALIBRATION_NAME)
    logging.info("%s", _enough_for(calibration, sum(end < decisions.length for end in ends), decisions.length))
    if repo_id is not None:
        push(repo_id, revision, "Calibrate the gate", write)
        logging.info("pushed %s to %s%s", CALIBRATION_NAME, repo_id, f" at {revision}" if revision else "")
    return calibration


def default_scores(adapter: Any) -> list[str]:
    """What is calibrated where nobody says what: the reverse scores of a flow, and what a gate asks by default."""
    known = [f"reverse:steps={steps}" for steps in (1, 2, 5, 10)] if "reverse" in adapter.scores else [*adapter.scores]
    asked = getattr(adapter, "gate_score", None)
    return known if asked is None or asked in known else [*known, asked]


def _decisions(adapter: Any, cfg: CalibrateConfig, length: int | None, longest: int, told: bool) -> Decisions:
    """Which chunks are scored: the expert's, or, of `length` actions, an agent's; `told` what came before.

    Raises:
        ValueError: If a length is longer than the adapter's chunk or than every episode, or an agent's chunks are
            longer than the adapter's: what they were cut to under later observations is not recorded.
    """
    size, history = adapter.config.chunk_size, getattr(adapter, "history", 0) if told else 0
    if length is not None and length > size:
        raise ValueError(f"the agent proposed {length} actions at a time, but the adapter corrects {size} at most")
    limit = min(length or size, longest)
    lengths = tuple(sorted(set(cfg.lengths))) if cfg.lengths else default_lengths(limit)
    if lengths[-1] > limit:
        what = "the longest episode has" if longest < (length or size) else "a chunk has"
        raise ValueError(f"lengths holds {lengths[-1]}, but {what} {limit} actions")
    if length is not None:
        return Decisions(lengths, length, length, history)
    return Decisions(lengths, cfg.stride, adapter.stride if history else 1, history)


def _enough_for(calibration: Calibration, short: int, length: int) -> str:
    """One line on what the chunks are too few for, so that it is not the evaluation that says it."""

    def least(by_episode: bool) -> str:
        found = {name: calibration.smallest_alpha(name, by_episode=by_episode) for name in calibration.scores}
        # Rounded up: a figure of the line is to be one that works.
        rounded = {name: f"{math.ceil(1e4 * alpha - 1e-9) / 1e4:g}" for name, alpha in found.items()}
        if len(set(rounded.values())) == 1:
            return next(iter(rounded.values()))
        return " and ".join(f"{alpha} by {name}" for name, alpha in rounded.items())

    line = (
        f"the smallest alpha of a gate: {least(False)} of chunks, {least(True)} of episodes (alpha_of=episodes); "
        "of joined scores times their number"
    )
    return line + (f"; {short} episodes are shorter than {length} actions and not among them" if short else "")


def main() -> None:
    """Entry point."""
    start()
    with one_line_errors("gloves calibrate"):
        calibrate()
