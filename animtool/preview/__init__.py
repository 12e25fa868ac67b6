"""Pages that play, and pictures of what was measured, which matplotlib draws."""
