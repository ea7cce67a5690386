"""`gloves check`: whether a trained adapter can tell an expert's chunks from others, before it corrects anybody."""

import sys
from dataclasses import dataclass, field, replace

from lerobot.configs import PreTrainedConfig, parser

from lerobot_gloves.checkpoints.held_out import HeldOutConfig
from lerobot_gloves.checkpoints.on_data import AdapterOnData, named_adapter, open_adapter
from lerobot_gloves.checkpoints.telling import KINDS, Chunks, losses, tell, verdict
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.commands.start import start
from lerobot_gloves.recording.sources import expert_episodes
from lerobot_gloves.specification import parse_all, specification
from lerobot_gloves.system.text import markdown_table

FORGOTTEN = 1.5
"""A held-out loss of more than so many times the training's is that of demonstrations known by heart."""
ALPHAS = (0.01, 0.05, 0.1)
USUAL = ("reverse:steps=1", "reverse:steps=5", "correction")
"""Scores that are looked at if nobody names any; all of an adapter that has none of them."""


@dataclass
class CheckConfig:
    """See whether a trained adapter can tell an expert's chunks from others, on episodes that it was not trained on.

    gloves check --policy.path=CHECKPOINT --dataset.repo_id=EXPERT

    Held-out chunks of the expert are scored as they are, and gone wrong: noised and shifted by half of and by one
    standard deviation of the data, scaled by a half, replaced by the chunk before and by one of another moment. Exit
    status 1 if by no score a chunk of another moment stands out.
    """

    # The episodes; --dataset.episodes picks some. By default, of the dataset that the adapter was trained on, those
    # that --dataset.eval_split held out of training, and of another dataset all.
    dataset: HeldOutConfig
    # The adapter: --policy.path= a checkpoint's folder or Hub id.
    policy: PreTrainedConfig | None = None
    # Nonconformity scores to look at, with their options; by default the one-step and the five-step reverse score, of a
    # copilot correction as well, of an adapter with others these.
    scores: list[str] = field(default_factory=list)
    # About how many chunks to score, spread over all of the episodes.
    chunks: int = 400
    # How far the time stamps of frames may be off, in seconds; by default what the training allowed.
    tolerance_s: float | None = None
    # Chunks scored at once.
    batch_size: int = 64

    def __post_init__(self) -> None:
        for name in ("chunks", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, but must be at least 1")
        self.policy = named_adapter()
        if self.policy is None:
            raise ValueError("gloves check needs --policy.path, the adapter's checkpoint")

    @classmethod
    def __get_path_fields__(cls) -> list[str]:
        return ["policy"]


@parser.wrap()
def check(cfg: CheckConfig) -> bool:
    """Run `gloves check`: whether the adapter is usable."""
    assert cfg.policy is not None
    opened = open_adapter(cfg.policy, cfg.dataset, cfg.tolerance_s)
    opened = replace(opened, episodes=expert_episodes(opened.episodes, opened.meta))
    known = opened.adapter.scores
    usual = [text for text in USUAL if text.partition(":")[0] in known]
    texts = cfg.scores or usual or list(known)
    scores = {specification(one, known): one for text in texts for one in parse_all(text, known, "score")}
    chunks = tell(opened, scores, cfg.chunks, cfg.batch_size)
    usable, line = verdict(chunks)
    print(report(opened, chunks, losses(opened, cfg.chunks, cfg.batch_size)))
    print(f"\n{line}")
    return usable


def report(opened: AdapterOnData, chunks: Chunks, loss: tuple[float, float] | None) -> str:
    """What was measured, as a page of Markdown."""
    count, episodes = len(chunks.episode), len(chunks.episode.unique())
    parts = [f"{count} chunks of {episodes} episodes of {opened.data.repo_id}"]
    if loss is not None:
        trained, held_out = loss
        heart = ": known by heart" if held_out > FORGOTTEN * trained else ""
        ratio = f"{held_out / trained:.2f} times as much"
        parts.append(f"loss {trained:.4f} on episodes of the training, {held_out:.4f} on the others, {ratio}{heart}")
    kinds = [kind for kind in KINDS if not all(of[kind].isnan().all() for of in chunks.scores.values())]
    if "replayed" not in kinds:
        parts.append("No episode is as long as two chunks, so that nothing can be replayed.")
    header = ["score", *kinds]
    rows = [
        [name, *(f"{a:.2f} [{low:.2f}, {high:.2f}]" for a, low, high in (chunks.area(name, kind) for kind in kinds))]
        for name in chunks.scores
    ]
    parts.append("Area under the ROC curve between clean chunks and others [95 % interval]:")
    parts.append(markdown_table([header, *rows]))
    header = ["score", "alpha", *kinds]
    rows = [
        [name, f"{alpha:g}", *(f"{100 * chunks.seen(name, kind, alpha):.0f} %" for kind in kinds)]
        for name in chunks.scores
        for alpha in ALPHAS
    ]
    parts.append("Turned away where a share alpha of the clean ones is:")
    parts.append(markdown_table([header, *rows]))
    parts.append(f"The smallest alpha that can turn anything away: {1 / (episodes + 1):.3f} of episodes.")
    return "\n\n".join(parts)


def main() -> None:
    """Entry point."""
    start()
    with one_line_errors("gloves check"):
        usable = check()
    sys.exit(0 if usable else 1)
