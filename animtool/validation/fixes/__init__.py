"""What `validate --fix` does to findings that have one safe and obvious remedy."""
