"""Control by a model: inverse control of an effector, and an observer of a robot's state."""
