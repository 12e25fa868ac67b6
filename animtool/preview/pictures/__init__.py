"""Pictures and films of what pages show, drawn off-screen with the shaders of pages."""
