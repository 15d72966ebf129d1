"""What keys do, for every user interface: their names, a robot's table of them, and the rules of a press."""
