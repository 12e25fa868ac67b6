"""Readers and writers of file formats: bytes to takes, and takes to bytes."""

# Largest float32; readers refuse, clamp or drop larger numbers.
FLOAT32_MAX = 3.4028234663852886e38
