"""A model that runs beside a robot, corrected by sensors: shape, contact, and whether it is right."""
