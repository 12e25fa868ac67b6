"""Tables of time against error."""
