"""Scene files: keys, entries and outputs, read with locations."""
