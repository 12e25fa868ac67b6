"""Batches: find, plan, build in several processes, and resume."""
