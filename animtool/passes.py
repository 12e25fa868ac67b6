"""The old name of `animtool.motion.passes`."""

from animtool.motion.passes import *  # noqa: F403
