"""The old name of `animtool.capture` and `animtool.retarget`."""
