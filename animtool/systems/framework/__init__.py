"""What all kinds of systems share: keys, kinds, runs, saved states, coupling."""
