"""What rules look at: a file of each kind, opened once."""
