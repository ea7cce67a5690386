"""The flow policy: the near-expert imitation agent of the paper's experiments."""
