"""Wrap a policy that is slow now and then, play each corridor of Slalom once, and see what was edited.

python examples/wrap_a_policy.py
"""

import lerobot_policy_gloves  # noqa: F401, makes LeRobot know the wrapper
from lerobot_gloves.demo import AGENT, EXPERT_FLOW, PACKAGED
from lerobot_gloves.evaluation.agent import load_agent
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.evaluation.rollout import rollout
from lerobot_gloves.tasks.slalom import SlalomEnv


def main() -> None:
    """The same episodes, raw and corrected by FEEG behind a gate."""
    task, agent, slow = SlalomEnv(obs_type="state"), str(PACKAGED / AGENT), "slow:alpha=0.25,p=0.75"
    corrected = {"adapter": str(PACKAGED / EXPERT_FLOW), "method": "feeg:start=0.3,align=0.1"}
    gate = {"gate": True, "alpha": 0.05, "score": "reverse:steps=5"}
    for name, options in (("raw", {}), ("corrected", corrected | gate)):
        with environments(task, 24) as env:
            episodes = rollout(env, load_agent(task, agent, slow, seed=0, **options), range(10000, 10024))
        chunks, edited = (sum(getattr(episode, what) for episode in episodes) for what in ("chunks", "edited"))
        print(f"{name}: {sum(e.success for e in episodes)} of 24 succeed, {edited} of {chunks} chunks edited")


if __name__ == "__main__":
    main()
