"""Speed of a simulation step, measured: what `softsim bench` runs. Nothing here prints."""
