"""What this machine has and how fast it is: `doctor`, `bench`, `test`."""
