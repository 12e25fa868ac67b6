"""Key reduction: a sampled take as sparse keys."""
