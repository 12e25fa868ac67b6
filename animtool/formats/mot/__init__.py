"""OpenSim motion (MOT, STO): joint coordinates over time."""

from animtool.formats.mot.read import read_mot, read_mot_rig
from animtool.formats.mot.write import write_mot

__all__ = ["read_mot", "read_mot_rig", "write_mot"]
