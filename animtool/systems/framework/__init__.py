"""Code shared by all systems: keys, kinds, runs, saved states, coupling."""
