"""The old name of `animtool.motion.markers`."""

from animtool.motion.markers import *  # noqa: F403
