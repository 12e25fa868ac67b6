"""Describes takes, and compares them."""
