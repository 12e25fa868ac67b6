"""Files that people write: YAML and JSON, read with places, checked all at once."""
