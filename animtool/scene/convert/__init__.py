"""Conversion of takes and rigs between file formats."""
