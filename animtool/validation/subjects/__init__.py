"""Subjects of rules: one type per kind of file."""
