"""The wrapper: any LeRobot policy as the agent, an adapter that corrects its proposals."""
