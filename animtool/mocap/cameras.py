"""The old name of `animtool.capture.cameras`."""

from animtool.capture.cameras import *  # noqa: F403
