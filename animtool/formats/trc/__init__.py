"""TRC: marker trajectories as text, used by OpenSim and others."""

from animtool.formats.trc.read import read_trc
from animtool.formats.trc.write import write_trc

__all__ = ["read_trc", "write_trc"]
