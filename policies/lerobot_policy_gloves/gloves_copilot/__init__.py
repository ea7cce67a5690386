"""The copilot: it reads the agent's proposals, infers what is wrong with them, and says what the expert would do."""
