"""TRC: marker trajectories as rows of text, as OpenSim and others read them."""

from animtool.formats.trc.read import read_trc
from animtool.formats.trc.write import write_trc

__all__ = ["read_trc", "write_trc"]
