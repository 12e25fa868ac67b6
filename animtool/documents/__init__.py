"""Hand-written YAML and JSON files, read with line numbers and completely checked."""
