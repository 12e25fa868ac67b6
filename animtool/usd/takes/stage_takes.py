"""Reads the takes of all characters of a stage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from animtool.motion.take import TakeStream
from animtool.usd.layers.sdf import usd_errors
from animtool.usd.layers.stderr import without_usd_warnings
from animtool.usd.rigs.prims import find_skeletons, open_stage
from animtool.usd.takes.read import read_character


def read_characters(path: Path) -> dict[str, Callable[[], TakeStream]]:
    """Return functions that read the take of each Skeleton, by Skeleton path.

    Empty for a layer without its rig.
    """
    with usd_errors(path), without_usd_warnings():
        stage = open_stage(path)

        def reader(skeleton_path: str) -> Callable[[], TakeStream]:
            def read() -> TakeStream:
                with usd_errors(path), without_usd_warnings():
                    return read_character(stage, path, skeleton_path)

            return read

        paths = [str(skeleton.GetPath()) for skeleton in find_skeletons(stage)]
        return {skeleton_path: reader(skeleton_path) for skeleton_path in paths}
