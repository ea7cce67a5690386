"""Make all that configs/bench/metaworld.yaml plays, from nothing: `python scripts/train_metaworld.py`.

One dataset of MetaWorld's experts in five tasks, LeRobot's own agents on it (ACT a task, Diffusion on two, a
language-conditioned multi-task DiT on all five), and the correctors, one of each on all five. Run again, it goes on
where it stopped. Everything goes to outputs/metaworld/, what each command prints to outputs/metaworld/logs/.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_gloves.checkpoints.image_size import resize_images
from lerobot_gloves.demo.pipeline import Calibrate, Dataset, Record, Stage, Train, make

TASKS = ("pick-place-v3", "peg-insert-side-v3", "door-open-v3", "drawer-open-v3", "assembly-v3")
"""Reaching and grasping, insertion, a door, a drawer, assembly; episodes of a recording take turns in this order."""
EPISODES = 40
"""Demonstrations of each."""
LONGER = 2
"""Times the steps of the agent that is trained longer: what an agent and the copilot, for all tasks, take together."""
ROOT = Path("outputs/metaworld")
DATA = Dataset("gloves/metaworld", Path("outputs/datasets/metaworld"))
SCORES = ("reverse:steps=1", "reverse:steps=5")
SIZE = 96
"""Height and width of the images, in pixels."""


def make_clip(folder: Path) -> None:
    """Save a CLIP of random weights, small enough for two cores, and a tokenizer of the words of the tasks."""
    from lerobot.envs.metaworld import TASK_DESCRIPTIONS
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import CLIPConfig, CLIPModel, PreTrainedTokenizerFast, set_seed

    set_seed(0)
    known = sorted({word for task in TASKS for word in TASK_DESCRIPTIONS[task].split()})
    vocabulary = {word: number for number, word in enumerate(["<pad>", "<end>", "<unknown>", *known])}
    words = Tokenizer(models.WordLevel(vocabulary, "<unknown>"))
    words.pre_tokenizer = pre_tokenizers.WhitespaceSplit()
    part = {"hidden_size": 128, "intermediate_size": 512, "num_hidden_layers": 4, "num_attention_heads": 4}
    text = part | {"vocab_size": len(vocabulary), "max_position_embeddings": 32, "eos_token_id": 1, "pad_token_id": 0}
    vision = part | {"image_size": SIZE, "patch_size": 16}
    config: Any = CLIPConfig  # its parts are keywords that its annotations do not know
    CLIPModel(config(text_config=text, vision_config=vision, projection_dim=128)).save_pretrained(folder)
    named = {"pad_token": "<pad>", "eos_token": "<end>", "unk_token": "<unknown>"}
    PreTrainedTokenizerFast(tokenizer_object=words, **named).save_pretrained(folder)


def train(model: str, name: str, *options: str, steps: int | None = None) -> Train:
    """A training run by configs/metaworld/<model>.yaml, called `name`."""
    return Train(name, Path(f"configs/metaworld/{model}.yaml"), DATA.options, ROOT / name, steps, options)


def agents() -> list[Train]:
    """LeRobot's own, and the two controls of ACT: trained longer, and larger."""
    found = []
    for index, task in enumerate(TASKS):
        episodes = f"--dataset.episodes={json.dumps(list(range(index, len(TASKS) * EPISODES, len(TASKS))))}"
        kinds = ("act", "act_large", "diffusion") if task in ("door-open-v3", "assembly-v3") else ("act", "act_large")
        found += [train(kind, f"{kind}_{task}", episodes) for kind in kinds]
        act = train("act", f"act_longer_{task}", episodes)
        found.append(train("act", act.label, episodes, steps=LONGER * act.wanted))
    return [*found, train("multi_task_dit", "multi_task_dit")]


def main() -> None:
    """Parse the arguments and make what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num_workers", type=int, default=2, help="processes of the recording")
    arguments = parser.parse_args()
    register_third_party_plugins()
    began = time.monotonic()

    def together(*stages: Stage) -> None:
        make(stages, ROOT / "logs", began=began)

    if not (ROOT / "clip").is_dir():
        make_clip(ROOT / "clip")
    kept = [f"--dataset.num_episodes={len(TASKS) * EPISODES}", f"--dataset.image_size={SIZE}", "--fast_rendering=true"]
    env = ["--env.type=metaworld", f"--env.task={','.join(TASKS)}"]
    together(Record("recording", env, DATA, [*kept, f"--num_workers={arguments.num_workers}"]))
    policies = agents()
    teacher = train("csa_teacher", "csa_teacher")
    flows = [train("expert_flow", "expert_flow"), train("copilot", "copilot")]
    together(*flows, teacher, *policies)
    for policy in policies:
        resize_images(policy.checkpoint)
    student = train("csa_student", "csa_student", f"--policy.teacher={teacher.checkpoint}")
    scores = {"expert_flow": SCORES, "copilot": (*SCORES, "correction")}
    calibrated = [Calibrate(f"calibration of {f.label}", f.checkpoint, DATA, scores[f.label]) for f in flows]
    together(student, *calibrated)


if __name__ == "__main__":
    main()
