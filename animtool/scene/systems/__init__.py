"""What a scene simulates, of whichever kind: entries, order, run and bake."""
