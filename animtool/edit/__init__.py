"""Changes to a whole take: when it is sampled, and which way is up."""
