"""One command that starts a robot, or one node of it: `up`, `run`."""
