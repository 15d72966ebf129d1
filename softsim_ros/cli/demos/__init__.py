"""Robots at work, driven on topics alone: `demo`."""
