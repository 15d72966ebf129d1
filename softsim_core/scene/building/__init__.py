"""From the description of a scene to the mechanical model."""
