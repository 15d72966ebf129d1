"""Compiled kernels of actuators: the step evaluates their kinds in its own compiled call."""
