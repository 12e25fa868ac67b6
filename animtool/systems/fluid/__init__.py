"""Fluids: particles that pressure keeps as dense as at rest."""
