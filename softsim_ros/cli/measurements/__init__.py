"""Models beside what was measured: `excite`, `validate`, `calibrate`."""
