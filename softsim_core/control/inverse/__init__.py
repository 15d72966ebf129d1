"""Inverse control: effector goals to joint commands, effector paths, the closed loop on tilts."""
