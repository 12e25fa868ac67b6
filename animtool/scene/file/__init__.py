"""Scene files: keys, entries and outputs, read with their locations."""
