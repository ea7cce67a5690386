"""Policies played in environments: an agent loaded and wrapped, a batch of environments, the rollout, its episodes."""
