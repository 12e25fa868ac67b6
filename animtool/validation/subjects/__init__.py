"""What rules look at: a file of each kind, checked once."""
