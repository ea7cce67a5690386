"""A person at the controls: the simulation, the person's proposals and their correction, the server and its page."""
