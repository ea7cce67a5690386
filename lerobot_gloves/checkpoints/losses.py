"""An adapter's loss on what its training has seen, and on what it has not."""

import torch
from lerobot.utils.constants import ACTION
from torch.utils.data import DataLoader, Subset

from lerobot_gloves.checkpoints.on_data import AdapterOnData


@torch.no_grad()
def losses(on_data: AdapterOnData, most: int, batch_size: int) -> tuple[float, float] | None:
    """The training's loss on frames that it has seen and on such that it has not; None where it is not known.

    Both are of the weights that inference uses, and of about as many frames.
    """
    seen = sorted(set(range(on_data.meta.total_episodes)) - set(on_data.episodes))
    if on_data.training is None or on_data.training.dataset.repo_id != on_data.data.repo_id or not seen:
        return None
    return _loss(on_data, seen, most, batch_size), _loss(on_data, on_data.episodes, most, batch_size)


def _loss(on_data: AdapterOnData, episodes: list[int], most: int, batch_size: int) -> float:
    adapter = on_data.adapter
    dataset = on_data.frames(episodes, adapter.config.action_delta_indices)
    picked = torch.linspace(0, len(dataset) - 1, min(most, len(dataset))).long().tolist()
    total = 0.0
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for item in DataLoader(Subset(dataset, picked), batch_size=batch_size):
            loss, _ = adapter.forward(on_data.preprocess(item))
            total += loss.item() * len(item[ACTION])
    return total / len(picked)
