"""`gloves tune`: choose an adapter's method and gate without a simulator."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from lerobot.configs import PreTrainedConfig, parser

from lerobot_gloves.checkpoints.calibration import Calibration, weights_hash
from lerobot_gloves.checkpoints.card import write_card
from lerobot_gloves.checkpoints.corrupted import corrupt_and_edit
from lerobot_gloves.checkpoints.held_out import HeldOutConfig
from lerobot_gloves.checkpoints.logged import p_values, read_log
from lerobot_gloves.checkpoints.on_data import named_adapter, open_adapter
from lerobot_gloves.checkpoints.recommendation import RECOMMENDATION_NAME, Recommendation
from lerobot_gloves.checkpoints.tuning import (
    ALPHAS,
    MOST_CHANGE,
    Outcome,
    best_first,
    gates_of,
    outcomes,
    settings_to_try,
)
from lerobot_gloves.commands.check import USUAL
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.commands.start import start
from lerobot_gloves.faults import RandomisedAgents
from lerobot_gloves.recording.sources import expert_episodes
from lerobot_gloves.specification import parse
from lerobot_gloves.system.text import markdown_table

SHOWN = 10


@dataclass
class TuneConfig:
    """Choose an adapter's method, its options, gate and alpha, without a simulator.

    gloves tune --policy.path=CHECKPOINT --dataset.repo_id=EXPERT

    The expert's held-out chunks are made faulty by agents drawn at random, and each is edited by each setting. Chosen
    is what comes nearest to the expert's chunks while it leaves those of a healthy agent alone. The choice is printed
    as options, and written into the adapter's folder, where the wrapper finds it if no method is named.
    """

    # The episodes; --dataset.episodes picks some. By default, of the dataset that the adapter was trained on, those
    # that --dataset.eval_split held out of training, and of another dataset all.
    dataset: HeldOutConfig
    # The adapter: --policy.path= a checkpoint's folder. Gates, fpas and copilot are tried if it is calibrated.
    policy: PreTrainedConfig | None = None
    # What to try, as in ["feeg:start=0.3", "feeg:start=0.35"]; by default a grid of each of the adapter's editors that
    # does not need the agent's own flow.
    methods: list[str] = field(default_factory=list)
    # What is wrong with the agents, each of one kind, strengths at random, names of lerobot_gloves.faults.FAULTS.
    faults: list[str] = field(default_factory=lambda: ["scale", "offset", "noise", "drift", "delay", "replay"])
    # How far a setting may move the expert's own chunks: the mean distance of an action, in units of the data's spread.
    most_change: float = MOST_CHANGE
    # A log that the wrapper wrote (--policy.log) with your agent while it was well; lines that say that they are
    # perturbed do not count. Gates are then held against what they stop of your agent's chunks as well.
    log: Path | None = None
    # About how many chunks to take, spread over all of the episodes.
    chunks: int = 300
    # How far the time stamps of frames may be off, in seconds; by default what the training allowed.
    tolerance_s: float | None = None
    # Chunks edited at once.
    batch_size: int = 32

    def __post_init__(self) -> None:
        for name in ("chunks", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, but must be at least 1")
        if not self.most_change > 0:
            raise ValueError(f"most_change is {self.most_change}, but must be above 0")
        RandomisedAgents(tuple(self.faults))  # refuses faults that there are not
        if self.log is not None:
            self.log = self.log.expanduser()
            if not self.log.is_file():
                raise FileNotFoundError(f"there is no log {self.log}")
        path = parser.get_path_arg("policy")
        if path and not Path(path).is_dir():
            raise ValueError(f"{path} is no folder, where the choice could be written: download the checkpoint first")
        self.policy = named_adapter()

    @classmethod
    def __get_path_fields__(cls) -> list[str]:
        return ["policy"]


@parser.wrap()
def tune(cfg: TuneConfig) -> Recommendation:
    """Run `gloves tune`."""
    assert cfg.policy is not None
    folder = Path(str(cfg.policy.pretrained_path))
    opened = open_adapter(cfg.policy, cfg.dataset, cfg.tolerance_s)
    opened = replace(opened, episodes=expert_episodes(opened.episodes, opened.meta))
    adapter, size = opened.adapter, opened.adapter.config.chunk_size
    weights = weights_hash(adapter.state_dict())
    calibration = Calibration.load(folder)
    names: Sequence[str] = ()
    if calibration is None:
        logging.warning("%s is not calibrated, so no gate is tried: run gloves calibrate first", folder)
    else:
        calibration.check(weights)
        names = [name for name in USUAL if name in calibration.scores] or list(calibration.scores)
    logged = {}
    if cfg.log is not None:
        if calibration is None:
            raise ValueError(f"--log tells of the gate, but {folder} is not calibrated: run gloves calibrate first")
        logged = p_values(read_log(cfg.log), names, calibration)
        if not logged:
            raise ValueError(f"{cfg.log} holds no healthy chunk with a score of {', '.join(names)}")
        names = list(logged)
    gates = gates_of(calibration, names, size)
    settings = settings_to_try(adapter, cfg.methods, gates)
    scores = {name: parse(name, adapter.scores, "score") for name in names}
    found = corrupt_and_edit(opened, settings, scores, cfg.faults, cfg.chunks, cfg.batch_size)
    ranked = best_first(outcomes(found, adapter.editors, gates, logged), cfg.most_change)
    best = ranked[0]
    chosen = Recommendation(
        method=best.method,
        gate=best.gate,
        score=best.score,
        alpha=ALPHAS[0] if best.alpha is None else best.alpha,
        repo_id=opened.data.repo_id,
        chunks=len(found.proposed),
        weights=weights,
    )
    print(report(ranked, cfg.most_change))
    print(f"\n{' '.join(chosen.flags)}")
    chosen.save(folder)
    write_card(folder, adapter, opened.trained, calibration, None, brief=True)
    logging.info("%d chunks of %d episodes -> %s", chosen.chunks, len(opened.episodes), folder / RECOMMENDATION_NAME)
    return chosen


def report(ranked: Sequence[Outcome], most_change: float) -> str:
    """The first of the outcomes as a table, and in a line what the figures are."""
    kinds = list(ranked[0].remains)
    header = ["method", "gate", "change", "edit", "mean", *kinds]
    rows = [
        [
            one.method,
            _test(one),
            *(f"{value:.3f}" for value in (one.change, one.edit)),
            *(f"{value:.2f}" for value in (one.mean, *one.remains.values())),
        ]
        for one in ranked[:SHOWN]
    ]
    return (
        f"{len(ranked)} settings, the chosen one first, then by mean.\n"
        f"change: how far the expert's own chunks are moved, at most {most_change:g}; edit: without the gate.\n"
        "mean, and by fault: the share of a faulty chunk's distance to the expert's that is left.\n\n"
        + markdown_table([header, *rows])
    )


def _test(one: Outcome) -> str:
    if one.score is None:
        return "no"
    return f"{'' if one.gate else 'no, asks '}{one.score}, alpha {one.alpha:g}"


def main() -> None:
    """Entry point."""
    start()
    with one_line_errors("gloves tune"):
        tune()
