"""`gloves bench`: task x perturbation x method x seed, every method in the same episodes."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from lerobot.configs import parser
from lerobot.envs import EnvConfig
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.utils import init_logging
from tqdm import tqdm

from lerobot_gloves.benchmark import search
from lerobot_gloves.benchmark.cluster import Cluster
from lerobot_gloves.benchmark.dry_run import try_all
from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.benchmark.local_workers import Processes, ThisProcess
from lerobot_gloves.benchmark.matrix import Task, cells, select, single_task
from lerobot_gloves.benchmark.matrix_file import complete
from lerobot_gloves.benchmark.plan import Job, finished_cells, plan
from lerobot_gloves.benchmark.workers import Note, Workers, play_all
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.report.markdown import report_markdown
from lerobot_gloves.specification import NONE

EXECUTORS = ("local", "ray")


# Options are explained by comments because LeRobot's parser shows those in --help.
@dataclass(kw_only=True)
class BenchConfig:
    """Run every perturbation with every method and seed, in the same episodes; run again, it goes on where it stopped.

    gloves bench --config_path=configs/bench/slalom.yaml --output_dir=outputs/bench/slalom
    runs the matrix of a file. One task needs no file:
    gloves bench --env.type=gloves_slalom --agent=AGENT --adapter=ADAPTER --output_dir=outputs/bench/first
    --perturbations='[none, "noised:sigma=0.005"]' --methods='[none, "feeg:start=0.5", "feeg:start=0.5+gate"]'
    """

    # Folder of the rows, one file a finished cell. Rows that are there already are not run again.
    output_dir: Path
    # In a file: tasks by name, each with env, agent, perturbations and methods by label. Options such as
    # --tasks.slalom.methods.FEEG.alpha=0.1 override it.
    tasks: dict[str, Task] = field(default_factory=dict)
    # A file that a search wrote with --choose: its settings go before those of the tasks' methods.
    chosen: Path | None = None
    # Without a file: the task, such as --env.type=gloves_slalom --env.obs_type=state.
    env: EnvConfig = None
    # Without a file: the policy to be corrected, a checkpoint's folder or Hub id.
    agent: str | None = None
    # Without a file: the checkpoint that scores and edits, a folder or Hub id. The method none does without.
    adapter: str | None = None
    # Without a file: nonconformity score and its options; by default the adapter's first.
    score: str | None = None
    # Without a file: the gate's significance level; by default 0.05.
    alpha: float | None = None
    # What is done to the agent: none, or specifications such as "laggy:p=0.2"; "noised+laggy:p=0.2" is both, one after
    # the other. With a file: labels, to run these only.
    perturbations: list[str] | None = None
    # How it is corrected: none for the raw agent, or editors such as "feeg:start=0.5"; "feeg:start=0.5+gate" is gated.
    # With a file: labels, to run these only.
    methods: list[str] | None = None
    # Seeds of the policies; seed s plays the environment seeds 100 s, 100 s + 1, ... of the split.
    seeds: list[int] = field(default_factory=lambda: [0])
    # Environment seeds to use: test, or validation for choosing settings.
    split: str = "test"
    # Episodes of each cell, at most 100.
    episodes: int = 30
    # Environments that run side by side in a cell.
    batch_size: int = 30
    # Whether Gymnasium's MuJoCo environments, such as MetaWorld's, draw without multisampling and with coarser shadows:
    # a third of the time in software, and nearly the same pictures.
    fast_rendering: bool = False
    # Who plays the cells: local, processes of this machine, or ray.
    executor: str = "local"
    # With ray: the cluster's address, such as 10.0.0.1:6379 or auto; by default one is started on this machine.
    address: str | None = None
    # With ray: the share of a GPU that each cell takes.
    num_gpus: float = 0.0
    # Cells that are played side by side, on one thread each; by default as many as there are cores.
    num_workers: int | None = None
    # Where a search writes the best setting of each method.
    choose: Path | None = None

    def __post_init__(self) -> None:
        # Where they come from a file, or from Python; what is typed is at home already.
        self.output_dir = self.output_dir.expanduser()
        self.chosen = self.chosen and self.chosen.expanduser()
        self.choose = self.choose and self.choose.expanduser()
        if self.num_workers is not None and self.num_workers < 1:
            raise ValueError(f"num_workers is {self.num_workers}, but must be at least 1")
        if self.executor not in EXECUTORS:
            raise ValueError(f"unknown executor {self.executor!r}: choose from {', '.join(EXECUTORS)}")
        if self.executor != "ray" and (self.address is not None or self.num_gpus):
            raise ValueError("address and num_gpus are for --executor=ray")
        for name in ("perturbations", "methods", "seeds"):
            if getattr(self, name) == []:
                raise ValueError(f"{name} is empty: nothing to run")
        # `env` is not declared as `EnvConfig | None`: the parser would not say what is wrong with a task's option.
        if not self.tasks and None in (self.env, self.agent):
            raise ValueError("name the tasks in a file, --config_path=FILE, or one by --env.type and --agent")
        alone = [name for name in ("env", "agent", "adapter", "score", "alpha") if getattr(self, name) is not None]
        if self.tasks and alone:
            raise ValueError(
                f"{alone[0]} is for a task without a file: override a file's tasks by options such as "
                "--tasks.NAME.agent=AGENT"
            )

    def matrix(self) -> dict[str, Task]:
        """The tasks to run."""
        if self.tasks:
            return select(self.tasks, self.perturbations, self.methods)
        assert self.agent is not None
        return single_task(
            self.env,
            self.agent,
            self.adapter,
            self.perturbations or [NONE],
            self.methods or [NONE],
            score=self.score,
            alpha=0.05 if self.alpha is None else self.alpha,
        )


@parser.wrap()
def bench(config: BenchConfig) -> list[str]:
    """Play all cells, print the report, and return a line for each cell that failed."""
    tasks = config.matrix()
    searching = search.check_search(tasks, config.split, config.seeds, config.episodes)
    if config.choose and not searching:
        raise ValueError("choose is for a search, but no method has settings to choose from")
    shared = {
        "split": config.split,
        "episodes": config.episodes,
        "batch_size": config.batch_size,
        "fast_rendering": config.fast_rendering,
    }
    jobs = plan(cells(tasks, config.seeds, **shared))
    config.output_dir.mkdir(parents=True, exist_ok=True)
    done = finished_cells(config.output_dir, jobs)
    missing = [job for job in jobs if job.cell not in done]
    failures = run_missing(config, missing, total=len(jobs)) if missing else []
    finished_cells(config.output_dir, jobs)  # another run may have added rows that do not fit
    rows = read_rows(config.output_dir)
    if searching:
        found = search.ranking(tasks, rows, config.seeds)
        print(search.describe(found), end="")
        if config.choose and not failures:
            search.write_chosen(config.choose, found, episodes=len(config.seeds) * config.episodes)
    elif rows:
        print(report_markdown(rows), end="")
    return failures


def run_missing(config: BenchConfig, missing: Sequence[Job], *, total: int) -> list[str]:
    """Play cells, with progress and time left on standard error; a line for each that failed."""
    try_all(missing)
    failures = []
    with (
        make_workers(config, len(missing)) as workers,
        tqdm(total=total, initial=total - len(missing), desc="bench", unit="cell", smoothing=0) as progress,
    ):
        for event in play_all(missing, config.output_dir, workers):
            if isinstance(event, Note):
                progress.write(event.text, file=sys.stderr)
                continue
            if event.failure:
                failures.append(event.failure)
                progress.write(event.failure, file=sys.stderr)
            progress.update()
    return failures


def make_workers(config: BenchConfig, most: int) -> Workers:
    """Who plays the cells, at most so many side by side."""
    if config.executor == "ray":
        return Cluster(config.address, config.num_workers, config.num_gpus)
    count = min(config.num_workers or len(os.sched_getaffinity(0)), most)
    return Processes(count) if count > 1 else ThisProcess()


def main() -> None:
    """Entry point."""
    init_logging(console_level="WARNING")
    register_third_party_plugins()
    with one_line_errors("gloves bench", "finished cells are kept: run the command again to go on"):
        sys.argv[1:] = complete(sys.argv[1:], BenchConfig)
        failures = bench()
    if failures:
        sys.exit(f"gloves bench: {len(failures)} cell(s) failed, see above; run the command again to try only those")
