"""Edits of USD layers for findings that have one safe fix."""
