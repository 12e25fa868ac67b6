"""Points that move: caches of meshes, curves and particles."""
