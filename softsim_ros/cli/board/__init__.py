"""A real servo board: `flash`, `calibrate-servos`."""
