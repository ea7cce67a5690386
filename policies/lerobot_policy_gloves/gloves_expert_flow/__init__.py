"""The expert flow: what the agent's proposals are scored by and edited towards."""
