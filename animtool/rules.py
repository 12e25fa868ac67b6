"""The old name of `animtool.core.rules`."""

from animtool.core.rules import *  # noqa: F403
