"""Episodes to LeRobotDataset: play them, stage each in a file of its own, assemble them, push the result."""
