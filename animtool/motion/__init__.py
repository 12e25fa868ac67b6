"""Motion of a rig over frames, and the passes that change it."""
