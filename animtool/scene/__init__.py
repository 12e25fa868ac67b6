"""Opening any source, and the bake that turns it into an output."""
