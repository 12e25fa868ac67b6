"""Hand-written YAML and JSON files: read with line numbers, checked all at once."""
