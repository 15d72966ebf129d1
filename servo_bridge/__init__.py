"""From joint angles to the serial board of a servo robot, and never beyond its limits."""
