"""What a gate turns away of proposals whose length lies between two that were scored, and what scoring costs.

Calibration chunks are taken for proposals: of the scores at length k, those above the threshold from

- the scores at k that are interpolated, chunk by chunk, between a shorter and a longer length,
- the larger of those two,
- the shorter length's own, if as many of a proposal's actions are judged, as after `gloves calibrate --lengths`.

The last are compared with themselves, so their share is that of the test.

    python scripts/study_lengths.py
"""

import argparse
import time
from pathlib import Path

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import get_policy_class, make_policy_config
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor

import lerobot_gloves.demo
import lerobot_policy_gloves  # noqa: F401, registers the policies
from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.checkpoints.scoring import Decisions, default_lengths, score_lengths
from lerobot_gloves.conformal import ConformalGate
from lerobot_gloves.scores import ReverseScore
from lerobot_gloves.system.text import markdown_table

BETWEEN = ((5, 7, 10), (2, 5, 10), (1, 3, 10))
"""A scored length, that of the proposals, and the next scored one."""
ALPHA = 0.05
STEPS = (1, 2, 5, 10)
"""Of the four scores that `gloves calibrate` takes by default."""


def turned_away(table: Tensor, below: int, length: int, above: int, alpha: float = ALPHA) -> tuple[float, float, float]:
    """Shares of n chunks of scores (T, n), a row for each length: interpolated, by the larger, by the first actions."""
    shorter, own, longer = (table[k - 1].double() for k in (below, length, above))
    share = (length - below) / (above - below)
    tests = (
        (torch.lerp(shorter, longer, share), own),
        (torch.maximum(shorter, longer), own),
        (shorter, shorter),
    )
    return tuple(1 - float(ConformalGate(known, alpha).admits(new).double().mean()) for known, new in tests)  # type: ignore[return-value]


def seconds(length: int, chunks: int) -> float:
    """Processor time of scoring chunks of the default width by the default scores, for the default lengths."""
    features = {OBS_STATE: PolicyFeature(FeatureType.STATE, (7,)), ACTION: PolicyFeature(FeatureType.ACTION, (7,))}
    given, made = {OBS_STATE: features[OBS_STATE]}, {ACTION: features[ACTION]}
    options = {
        "chunk_size": length,
        "n_action_steps": length,
        "input_features": given,
        "output_features": made,
        "device": "cpu",
    }
    policy = get_policy_class("gloves_expert_flow")(make_policy_config("gloves_expert_flow", **options)).eval()
    batch = {OBS_STATE: torch.randn(chunks, 7), ACTION: torch.randn(chunks, 1, length, 7)}
    began = time.process_time()
    with torch.no_grad():
        score_lengths(policy, batch, [ReverseScore(steps) for steps in STEPS], Decisions(default_lengths(length), 1))
    return time.process_time() - began


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    demo = Path(lerobot_gloves.demo.__file__).parent / "expert_flow"
    parser.add_argument("--adapter", default=str(demo), help="an adapter that is calibrated for every length")
    parser.add_argument("--chunk", type=int, default=100, help="actions of a chunk whose scoring is timed")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    calibration = Calibration.load(arguments.adapter)
    if calibration is None:
        parser.error(f"{arguments.adapter} is not calibrated")
    rows = []
    for name, table in calibration.scores.items():
        for below, length, above in BETWEEN:
            shares = turned_away(table, below, length, above)
            rows.append([name, f"{below}, {above}", str(length), *(f"{share:.3f}" for share in shares)])
    headers = [
        "score",
        "lengths scored",
        "of length",
        "interpolated",
        "by the larger of the two",
        "by its first actions",
    ]
    print(markdown_table([headers, *rows]))
    lengths = ", ".join(map(str, default_lengths(arguments.chunk)))
    print(
        f"\n64 chunks of {arguments.chunk} actions, lengths {lengths}: {seconds(arguments.chunk, 64):.1f} s of a core"
    )


if __name__ == "__main__":
    main()
