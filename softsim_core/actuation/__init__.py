"""Actuation: joint limits, commands, animations."""
