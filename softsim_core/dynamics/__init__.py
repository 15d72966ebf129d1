"""The time step: two implementations behind one interface, and the simulation around them."""
