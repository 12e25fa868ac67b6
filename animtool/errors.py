"""The old name of `animtool.core.errors`."""

from animtool.core.errors import *  # noqa: F403
