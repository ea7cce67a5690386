"""`gloves demo`: an imperfect policy gets better without being touched."""

import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from lerobot.configs import parser
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.demo import AGENT, COPILOT, EXPERT_FLOW, PACKAGED, TRIO
from lerobot_gloves.demo.evaluation import Comparison, PlayedRun, Run, evaluation, perturbation_options, read
from lerobot_gloves.demo.illustrations import PICTURE, VIDEO, show
from lerobot_gloves.demo.table import table
from lerobot_gloves.demo.training import Training, train_trio
from lerobot_gloves.editors import FEEG, FPAS
from lerobot_gloves.evaluation.seeds import TEST
from lerobot_gloves.scores import SCORES
from lerobot_gloves.specification import parse
from lerobot_gloves.system.files import whole
from lerobot_gloves.system.interrupts import interrupts_ignored
from lerobot_gloves.system.processes import clock, ended
from lerobot_gloves.tasks.panda import arm_file, import_mujoco

TASK, TABLE = "slalom", "table.md"


# LeRobot's parser shows the comments above the options in --help; a list of them in the docstring would confuse it.
@dataclass(kw_only=True)
class DemoConfig:
    """Evaluate one policy raw and corrected under a perturbation; with --train=true make the policies first."""

    # What makes the agent imperfect: a perturbation with its options, or several, as in noised+laggy:p=0.3.
    perturbation: str = "slow:alpha=0.25,p=0.75"
    # Options of FPAS, such as fpas:candidates=32.
    fpas: str = "fpas:sigma=0.2,align=0.0"
    # Nonconformity score that FPAS searches by, and its options.
    fpas_score: str = "reverse:steps=1"
    # Options of FEEG without gate, such as feeg:start=0.5. All settings are those that validation seeds chose.
    feeg: str = "feeg:start=0.4,align=0.3"
    # Options of FEEG where a gate spares what looks like the expert's.
    gated_feeg: str = "feeg:start=0.3,align=0.1"
    # Nonconformity score of the gate and its options.
    score: str = "reverse:steps=5"
    # The gate's significance level.
    alpha: float = 0.05
    # Episodes of each method.
    episodes: int = 96
    # Seed of the first episode; the others follow it.
    seed: int = TEST
    # Folder of another agent for Slalom than the one that ships with the package.
    agent: Path | None = None
    # Folder of another expert flow, calibrated.
    expert_flow: Path | None = None
    # Folder of another copilot, calibrated.
    copilot: Path | None = None
    # Where everything is written.
    output_dir: Path = Path("outputs/demo")
    # Make agent, expert flow and copilot from nothing; run again, it goes on where it stopped.
    train: bool = False
    # Demonstrations to train on.
    demonstrations: int = 400
    # Optimiser steps of each of the three; by default what their configurations say.
    steps: int | None = None

    def __post_init__(self) -> None:
        perturbation_options(self.perturbation)
        parse(self.fpas, {"fpas": FPAS}, "method")
        parse(self.feeg, {"feeg": FEEG}, "method")
        parse(self.gated_feeg, {"feeg": FEEG}, "method")
        parse(self.score, SCORES, "score")
        parse(self.fpas_score, SCORES, "score")
        for name in ("episodes", "demonstrations", "steps"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name} is {value}, but must be at least 1")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}, but must not be negative")
        if self.train and (self.agent or self.expert_flow or self.copilot):
            raise ValueError("--train=true makes all three: leave --agent, --expert_flow and --copilot out")


@parser.wrap()
def demo(cfg: DemoConfig) -> None:
    """Run `gloves demo`."""
    began = time.monotonic()
    import_mujoco(TASK), arm_file(TASK)  # what is missing shall not show in a command's traceback
    if cfg.train:
        scores = tuple(dict.fromkeys([cfg.fpas_score, cfg.score]))
        train_trio(Training(cfg.output_dir, cfg.demonstrations, cfg.steps, scores), began=began)
    shipped = cfg.output_dir if cfg.train else PACKAGED
    folders = {name: getattr(cfg, name) or shipped / name for name in TRIO}
    for option, folder in folders.items():
        if not (folder / "config.json").is_file():
            raise FileNotFoundError(f"--{option}: {folder} holds no policy")
    comparison = Comparison(folders[AGENT], cfg.perturbation, cfg.episodes, cfg.seed, cfg.output_dir / "evaluations")
    print(f"{headline(comparison)}: two runs of lerobot-eval side by side", flush=True)
    played, shown = play(comparison, runs(cfg, folders[EXPERT_FLOW], folders[COPILOT]), cfg.output_dir, began)
    text = table(played)
    print(f"\n{text}\n", flush=True)
    note = shown.result()
    with whole(cfg.output_dir / TABLE) as part:
        part.write_text(f"{headline(comparison)}.\n\n{text}\n\n{note}\n")
    written = [cfg.output_dir / name for name in (TABLE, PICTURE, VIDEO)]
    print(note, *(file for file in written if file.exists()), sep="\n")
    print(f"[{clock(time.monotonic() - began)}] done")


def play(
    comparison: Comparison, wanted: Sequence[Run], folder: Path, began: float
) -> tuple[list[PlayedRun], "Future[str]"]:
    """Play all runs, and draw the first and the last one as soon as both are there.

    Returns:
        What was played, in the order of the runs, and what the video shows.
    """
    raw, *others, corrected = wanted
    # What is drawn runs first, and the painter only takes what the other runs leave of the processor.
    commands = {evaluation(comparison, run): run for run in (raw, corrected, *others)}
    played: dict[Run, PlayedRun] = {}
    context = multiprocessing.get_context("spawn")  # OpenGL does not survive a fork
    with (
        ProcessPoolExecutor(1, context, os.nice, (10,)) as painter,
        closing(ended(list(commands), began=began)) as finished,
    ):
        for command in finished:
            played[commands[command]] = read(comparison, commands[command])
            if played.keys() == {raw, corrected}:
                with interrupts_ignored():  # by the painter, which the end of this process ends
                    shown = painter.submit(show, comparison, played[raw], played[corrected], folder)
        return [played[run] for run in wanted], shown


def headline(comparison: Comparison) -> str:
    """What all runs have in common."""
    first, count = comparison.seed, comparison.episodes
    seeds = f"(seeds {first}-{first + count - 1})"
    return f"Slalom, agent {comparison.perturbation}, the same {count} episodes each {seeds}"


def runs(cfg: DemoConfig, expert_flow: Path, copilot: Path) -> list[Run]:
    """The rows of the table; the last one is the corrected agent of the picture and the video."""
    adapter = f"--policy.adapter={expert_flow}"
    fpas = [adapter, f"--policy.score={cfg.fpas_score}", f"--policy.method={cfg.fpas}"]
    feeg = [adapter, f"--policy.score={cfg.score}", f"--policy.method={cfg.feeg}"]
    gate = ["--policy.gate=true", f"--policy.score={cfg.score}", f"--policy.alpha={cfg.alpha}"]
    gated = [adapter, f"--policy.method={cfg.gated_feeg}", *gate]
    return [
        Run("raw", "raw agent", recorded=True),
        Run("fpas", "FPAS", fpas),
        Run("feeg", "FEEG", feeg),
        Run("feeg_gate", "FEEG + gate", gated),
        Run("copilot", "copilot", [f"--policy.adapter={copilot}"], recorded=True),
    ]


def main() -> None:
    """Entry point."""
    register_third_party_plugins()
    with one_line_errors("gloves demo"):
        try:
            demo()
        except (ChildProcessError, RuntimeError) as error:  # of a command; of OpenGL or a replay
            sys.exit(f"gloves demo: {error}")
