"""Files: checked opening of inputs, and atomic outputs."""
