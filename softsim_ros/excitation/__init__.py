"""Measuring a robot on its topics: what its sensors say while it is moved, as a data set."""
