"""Many files made alike: found, planned, made by several processes, and resumed."""
