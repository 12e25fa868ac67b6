"""Readers and writers of file formats: bytes to takes, and takes to bytes."""
