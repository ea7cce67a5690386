"""Bands of environment seeds that never meet: nothing is chosen, trained or calibrated on what it is tested on."""

TEST, VALIDATION, DEMONSTRATIONS, PROPOSALS = 10000, 20000, 30000, 40000
"""Where the seeds of each use begin; demonstrations and an agent's recorded proposals stay below 50000."""
ALL = 100000
"""What all of them stay below: a seed that is this much larger is nobody's."""
SPLITS = {"test": TEST, "validation": VALIDATION}
"""Where those of a benchmark's splits do."""
BAND = 100
"""How many seeds of policies a split has room for, and how many episodes each of them."""


def environment_seeds(split: str, seed: int, episodes: int) -> range:
    """Seeds of the environments that a policy with seed s plays: 100 s + i of the split's band.

    Args:
        split: One of `SPLITS`.
        seed: s, below `BAND`.
        episodes: How many, at most `BAND`.
    """
    first = SPLITS[split] + BAND * seed
    return range(first, first + episodes)


def policy_seed(split: str, seed: int) -> int:
    """What agent, perturbation and editor draw from as the policy with seed s: s itself on the split test.

    On another they draw otherwise: where a task has few initial states, the same draws would make the same episodes.
    """
    return SPLITS[split] - TEST + seed
