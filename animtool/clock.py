"""The old name of `animtool.core.clock`."""

from animtool.core.clock import *  # noqa: F403
