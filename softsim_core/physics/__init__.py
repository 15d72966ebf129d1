"""The physics: linear algebra, meshes, finite elements, actuators, contact, the time step, sensors."""
