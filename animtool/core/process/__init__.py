"""Processes: signals, supervised workers, threads of linear algebra."""
