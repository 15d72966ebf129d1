"""Scene files: YAML and Python scenes, their keys, where they are found, and their forms as text."""
