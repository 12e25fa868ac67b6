"""Readers and writers, one a format: text and bytes to takes and back."""
