"""What workers need, imported before the first item: where they are forked, only once.

Importing this module is all there is to do. USD is imported and not used: the threads
that it starts would not outlive a fork.
"""

from __future__ import annotations

import gc
from importlib import import_module

MODULES = (
    "animtool.batch.work",
    "animtool.clip.file",
    "animtool.edit.loop",
    "animtool.edit.thin",
    "animtool.edit.trim",
    "animtool.formats.bvh.read",
    "animtool.scene.bake",
    "animtool.scene.clips",
    "animtool.scene.file",
    "animtool.scene.library",
    "animtool.usd.author",
    "animtool.usd.meshes",
    "animtool.usd.read",
    "animtool.usd.target",
)

for name in MODULES:
    import_module(name)

# What stays to the end is not looked through for circles again and again, and pages
# that forked processes share stay shared.
gc.freeze()
