"""Fixes of `validate --fix` for findings with one safe remedy."""
