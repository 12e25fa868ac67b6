"""The old name of `animtool.core.readers`."""

from animtool.core.readers import *  # noqa: F403
