"""`gloves check`: whether a trained adapter can tell an expert's chunks from others, before it corrects anybody."""

import logging
import math
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig, parser

from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.checkpoints.card import write_card
from lerobot_gloves.checkpoints.checked import Checked, check_adapter
from lerobot_gloves.checkpoints.held_out import HeldOutConfig
from lerobot_gloves.checkpoints.hub import push, pushed_to
from lerobot_gloves.checkpoints.logged import of_one_length, read_log
from lerobot_gloves.checkpoints.on_data import AdapterOnData, named_adapter, open_adapter
from lerobot_gloves.checkpoints.telling import spread_out
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.commands.start import start
from lerobot_gloves.recording.asked import asked
from lerobot_gloves.recording.sources import expert_episodes
from lerobot_gloves.report.check_tables import check_card, check_text
from lerobot_gloves.specification import parse_all, specification
from lerobot_gloves.system.files import write_text

USUAL = ("reverse:steps=1", "reverse:steps=5", "correction")
"""Scores that are looked at if nobody names any; all of an adapter that has none of them."""


@dataclass
class CheckConfig:
    """See whether a trained adapter can tell an expert's chunks from others, on episodes that it was not trained on.

    gloves check --policy.path=CHECKPOINT --dataset.repo_id=EXPERT
    gloves check --policy.path=CHECKPOINT --dataset.repo_id=EXPERT --agent=AGENT --html=check.html

    Held-out chunks of the expert are scored as they are, and gone wrong: noised and shifted by half of and by one
    standard deviation of the data, scaled by a half, replaced by the chunk before and by one of another moment. Exit
    status 1 if by no score a chunk of another moment stands out.
    """

    # The episodes; --dataset.episodes picks some. By default, of the dataset that the adapter was trained on, those
    # that --dataset.eval_split held out of training, and of another dataset all.
    dataset: HeldOutConfig
    # The adapter: --policy.path= a checkpoint's folder or Hub id.
    policy: PreTrainedConfig | None = None
    # Your agent, a folder or Hub id of any policy: what it proposes for the same observations stands beside the expert.
    agent: str | None = None
    # Or a log of it, as --policy.log wrote it with this adapter.
    log: Path | None = None
    # Nonconformity scores to look at, with their options; by default the one-step and the five-step reverse score, of a
    # copilot correction as well, of an adapter with others these.
    scores: list[str] = field(default_factory=list)
    # About how many chunks to score, spread over all of the episodes; of small data all that there are.
    chunks: int = 400
    # How far the time stamps of frames may be off, in seconds; by default what the training allowed.
    tolerance_s: float | None = None
    # Chunks scored at once.
    batch_size: int = 64
    # File for one page with tables and a picture, which needs no other file.
    html: Path | None = None
    # Whether to say what was found in the model card of the checkpoint's Hub repository, at the branch
    # --policy.pretrained_revision, and in that of its folder.
    push_to_hub: bool = False

    def __post_init__(self) -> None:
        for name in ("chunks", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, but must be at least 1")
        if self.agent is not None and self.log is not None:
            raise ValueError("agent and log are both given: name one of them")
        if self.log is not None and not self.log.is_file():
            raise FileNotFoundError(f"{self.log} is no file: --log takes what --policy.log wrote")
        if self.html is not None and self.html.is_dir():
            raise ValueError(f"{self.html} is a folder: --html takes the file to write")
        self.policy = named_adapter()

    @classmethod
    def __get_path_fields__(cls) -> list[str]:
        return ["policy"]


@parser.wrap()
def check(cfg: CheckConfig) -> bool:
    """Run `gloves check`: whether the adapter is usable."""
    assert cfg.policy is not None
    repo_id = pushed_to(cfg.policy) if cfg.push_to_hub else None
    opened = open_adapter(cfg.policy, cfg.dataset, cfg.tolerance_s)
    opened = replace(opened, episodes=expert_episodes(opened.episodes, opened.meta))
    scores = _scores(cfg, opened)
    size = opened.adapter.config.chunk_size
    what: dict[str, Any] = {}
    if cfg.agent is not None:
        what = {"agent": cfg.agent, "ask": asked(cfg.agent, opened.meta, str(cfg.policy.device))}
    if cfg.log is not None:
        known = of_one_length(read_log(cfg.log), size)
        if lacking := [name for name in scores if name not in known.scores]:
            there = ", ".join(known.scores)
            raise ValueError(f"{cfg.log} has no {', '.join(lacking)}, but {there}: name these by --scores")
        left = f", without {known.others} of other lengths" if known.others else ""
        what = {"agent": f"{cfg.log} ({len(next(iter(known.scores.values())))}{left})", "known": known}
    print(beforehand(opened, cfg.chunks), end="\n\n", flush=True)
    checked = check_adapter(opened, scores, cfg.chunks, cfg.batch_size, **what)
    print(f"{check_text(checked)}\n\n{checked.line}")
    if cfg.html is not None:
        from lerobot_gloves.report.check_page import check_page  # matplotlib takes a second to import

        write_text(cfg.html, check_page(checked))
    if repo_id is not None:
        _push(cfg.policy, opened, checked, repo_id)
    return checked.usable


def beforehand(opened: AdapterOnData, most: int) -> str:
    """What is going to be scored, and for what that is too little: known before anything is.

    Raises:
        ValueError: If no episode is as long as a chunk.
    """
    size = opened.adapter.config.chunk_size
    every, count = spread_out(opened.lengths, size, most)
    episodes = sum(length >= size for length in opened.lengths)
    short = len(opened.lengths) - episodes
    # Rounded up: a figure of the line is to be one that works.
    chunk, episode = (math.ceil(1e4 / (1 + number)) / 1e4 for number in (count, episodes))
    return (
        f"{count} chunks of {episodes} episodes of {opened.data.repo_id}, one every "
        f"{f'{every} frames' if every > 1 else 'frame'}"
        + (f" ({short} episodes are shorter than {size} actions and not among them)" if short else "")
        + f": the smallest alpha of a gate on them is {chunk:g} of chunks, {episode:g} of episodes"
    )


def _scores(cfg: CheckConfig, opened: AdapterOnData) -> dict[str, Any]:
    known = opened.adapter.scores
    usual = [text for text in USUAL if text.partition(":")[0] in known]
    texts = cfg.scores or usual or list(known)
    return {specification(one, known): one for text in texts for one in parse_all(text, known, "score")}


def _push(policy: PreTrainedConfig, opened: AdapterOnData, checked: Checked, repo_id: str) -> None:
    """Say what was found in the card of a folder, if the checkpoint is one, and in that of the repository."""
    path, revision = str(policy.pretrained_path), policy.pretrained_revision
    calibration = Calibration.load(path, revision)

    def write(folder: Path) -> None:
        write_card(folder, opened.adapter, opened.trained, calibration, repo_id, check_card(checked))

    if Path(path).is_dir():
        write(Path(path))
    push(repo_id, revision, "Say what gloves check found", write)
    logging.info("pushed what was found to the card of %s%s", repo_id, f" at {revision}" if revision else "")


def main() -> None:
    """Entry point."""
    start()
    with one_line_errors("gloves check"):
        usable = check()
    sys.exit(0 if usable else 1)
