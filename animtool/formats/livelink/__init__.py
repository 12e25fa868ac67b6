"""Live Link Face recordings (CSV): blend shape weights and angles per frame."""

from animtool.formats.livelink.read import read_livelink, read_livelink_rig
from animtool.formats.livelink.write import write_livelink

__all__ = ["read_livelink", "read_livelink_rig", "write_livelink"]
