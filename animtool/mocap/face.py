"""The old name of `animtool.capture.face`."""

from animtool.capture.face import *  # noqa: F403
