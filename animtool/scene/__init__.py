"""Sources, scene files, solves and the bake that writes their takes."""
