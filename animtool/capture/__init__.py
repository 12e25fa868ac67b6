"""Motion capture: from cameras, markers and faces to motion."""
