"""A trained policy in front of a robot."""
