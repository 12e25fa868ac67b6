"""The old name of `animtool.retarget`."""

from animtool.retarget import *  # noqa: F403
