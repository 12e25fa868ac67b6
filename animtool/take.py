"""The old name of `animtool.motion.take`."""

from animtool.motion.take import *  # noqa: F403
