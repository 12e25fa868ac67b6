"""Batches: finds, plans and builds items in several processes, and resumes."""
