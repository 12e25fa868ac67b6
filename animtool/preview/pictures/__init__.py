"""Pictures and films of pages, rendered off-screen with the viewer's shaders."""
