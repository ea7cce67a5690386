"""Scripted drivers of three skills in a task, alone and corrected, on the same seeds.

    python scripts/study_drivers.py --task=slalom --correct copilot=<its copilot for a person>
    python scripts/study_drivers.py --task=slalom --correct FEEG=<its expert flow>@feeg:start=0.4,align=0.1

prints a table; on test seeds it writes the rows that `docs/results/drivers.md` is made of, and leaves those of settings
that it was not asked for as they are.
"""

import argparse
import gzip
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from lerobot.envs import EnvConfig

import lerobot_policy_gloves  # noqa: F401, registers the policies
from lerobot_gloves.drive.assistance import load_person
from lerobot_gloves.drive.driver import SKILLS
from lerobot_gloves.drive.surrogates import play
from lerobot_gloves.drive.view import view_of
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.evaluation.seeds import SPLITS, environment_seeds
from lerobot_gloves.report.drivers import RAW, drivers_table

ROWS = Path(__file__).parents[1] / "docs" / "rows" / "drivers"


def options_of(text: str) -> tuple[str, dict[str, Any]]:
    """A setting's name and its options of the wrapper, of NAME=ADAPTER[@METHOD[@SCORE@ALPHA]].

    Raises:
        ValueError: If it is not written so.
    """
    name, equals, rest = text.partition("=")
    adapter, *parts = rest.split("@")
    if not (name and equals and adapter) or len(parts) not in (0, 1, 3):
        raise ValueError(f"--correct takes NAME=ADAPTER[@METHOD[@SCORE@ALPHA]], not {text!r}")
    options: dict[str, Any] = {"adapter": adapter, "method": parts[0] if parts else None}
    if len(parts) == 3:
        options |= {"gate": True, "score": parts[1], "alpha": float(parts[2])}
    return name, options


def drive(env: EnvConfig, settings: dict[str, dict], skills: list[str], split: str, seeds: int, episodes: int) -> list:
    """The rows of some drivers in each of some settings."""
    task, view, rows = env.type.removeprefix("gloves_"), view_of(env), []
    with environments(env, episodes) as vector:
        for setting, options in settings.items():
            person = load_person(env, options, "cpu")
            for skill in skills:
                for seed in range(seeds):
                    played = play(
                        vector, person, env.type, view, SKILLS[skill], environment_seeds(split, seed, episodes)
                    )
                    own = {"task": task, "setting": setting, "driver": skill}
                    rows += [{**own, "began": env.initial_state(one.seed), **asdict(one)} for one in played]
    return rows


def keep(rows: list[dict], file: Path) -> None:
    """Write rows into a file, in the place of those of the same settings."""
    text = gzip.decompress(file.read_bytes()).decode() if file.is_file() else ""
    new = {row["setting"] for row in rows}
    before = [row for row in map(json.loads, text.splitlines()) if row["setting"] not in new]
    text = "".join(json.dumps(row) + "\n" for row in [*rows, *before])
    file.write_bytes(gzip.compress(text.encode(), mtime=0))


def main() -> None:
    """Drive, write and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", required=True, choices=("slalom", "keypad", "can"))
    parser.add_argument(
        "--correct", nargs="*", default=[], help="NAME=ADAPTER[@METHOD[@SCORE@ALPHA]], with a gate if a score is named"
    )
    parser.add_argument("--drivers", nargs="*", default=list(SKILLS), choices=list(SKILLS))
    parser.add_argument("--split", default="validation", choices=sorted(SPLITS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--episodes", type=int, default=30, help="of each seed, driver and setting")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    try:
        settings = {RAW: {}, **dict(map(options_of, arguments.correct))}
    except ValueError as error:
        parser.error(str(error))
    env = EnvConfig.get_choice_class(f"gloves_{arguments.task}")()
    rows = drive(env, settings, arguments.drivers, arguments.split, arguments.seeds, arguments.episodes)
    if arguments.split == "test":
        ROWS.mkdir(parents=True, exist_ok=True)
        keep(rows, ROWS / f"{arguments.task}.jsonl.gz")
    print(drivers_table(rows))


if __name__ == "__main__":
    main()
