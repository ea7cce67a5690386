"""`gloves bench`: perturbation x method x seed on a task, every method in the same episodes."""

import itertools
import sys
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path

from lerobot.configs import parser
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.utils import init_logging
from tqdm import tqdm

from lerobot_gloves.benchmark.cell import GATE, NONE, Cell, Setup, load
from lerobot_gloves.benchmark.report import report
from lerobot_gloves.benchmark.rows import conditions, finished_cells, read_rows
from lerobot_gloves.benchmark.workers import play_all
from lerobot_gloves.commands.errors import one_line_errors


@dataclass(kw_only=True)
class BenchConfig(Setup):
    """Run every perturbation with every method and seed, in the same episodes; run again, it goes on where it stopped.

    gloves bench --env.type=gloves_slalom --agent=AGENT --adapter=ADAPTER --output_dir=outputs/bench/first
    --perturbations='[none, "noised:sigma=0.005"]' --methods='[none, "feeg:start=0.5", "feeg:start=0.5+gate"]'
    """

    # Folder of the rows, one file a finished cell. Rows that are there already are not run again.
    output_dir: Path
    # What is done to the agent: none, or specifications such as "laggy:p=0.2".
    perturbations: list[str] = field(default_factory=lambda: [NONE])
    # How it is corrected: none for the raw agent, or editors such as "feeg:start=0.5"; "feeg:start=0.5+gate" is gated.
    methods: list[str] = field(default_factory=lambda: [NONE])
    # Seeds of the policies; seed s plays the environment seeds 100 s, 100 s + 1, ... of the split.
    seeds: list[int] = field(default_factory=lambda: [0])
    # Processes that play cells side by side, on one thread each.
    num_workers: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.num_workers < 1:
            raise ValueError(f"num_workers is {self.num_workers}, but must be at least 1")
        for name in ("perturbations", "methods", "seeds"):
            if not getattr(self, name):
                raise ValueError(f"{name} is empty: nothing to run")


@parser.wrap()
def bench(config: BenchConfig) -> list[str]:
    """Play all cells, print the report, and return a line for each cell that failed."""
    # Seeds outermost: a run cut short has whole tables of fewer seeds.
    matrix = itertools.product(config.seeds, config.perturbations, config.methods)
    cells = list(dict.fromkeys(Cell(perturbation, method, seed) for seed, perturbation, method in matrix))
    planned = conditions(config, cells)
    config.output_dir.mkdir(parents=True, exist_ok=True)
    done = finished_cells(config.output_dir, planned)
    missing = {cell: here for cell, here in planned.items() if cell not in done}
    if missing:
        # Whatever is wrong with checkpoints and calibration shows here once, rather than in every cell.
        load(config, max(missing, key=lambda cell: (cell.method.endswith(GATE), cell.method != NONE)))
    failures = []
    with tqdm(total=len(cells), initial=len(done), desc="bench", unit="cell", smoothing=0) as progress:
        for failure in play_all(config, missing, config.output_dir, config.num_workers):
            if failure is not None:
                failures.append(failure)
                progress.write(failure, file=sys.stderr)
            progress.update()
    rows = read_rows(config.output_dir)
    if rows:
        print(report(rows), end="")
    return failures


def main() -> None:
    """Entry point."""
    init_logging(console_level="WARNING")
    register_third_party_plugins()
    with one_line_errors("gloves bench"):
        try:
            failures = bench()
        except BrokenProcessPool:
            sys.exit(
                "gloves bench: a worker process was killed, perhaps for memory; "
                "finished cells are kept: run the command again to go on"
            )
    if failures:
        sys.exit(f"gloves bench: {len(failures)} cell(s) failed, see above; run the command again to try only those")
