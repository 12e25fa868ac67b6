"""Opens and writes layers; checks their names and values."""
