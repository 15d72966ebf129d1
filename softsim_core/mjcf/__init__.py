"""MuJoCo models (MJCF) as scenes of ours, and scenes of ours as MuJoCo models."""
