"""C3D: marker trajectories of optical motion capture systems."""

from animtool.formats.c3d.read import read_c3d
from animtool.formats.c3d.write import write_c3d

__all__ = ["read_c3d", "write_c3d"]
