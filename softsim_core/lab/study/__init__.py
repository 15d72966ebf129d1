"""Studies: many runs of one scene with values that vary, on the cores of a machine or a cluster."""
