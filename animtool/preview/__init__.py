"""Pictures of what was measured; matplotlib draws them, and is loaded for that only."""
