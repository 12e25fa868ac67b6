"""What ``animtool bake`` reads: files, and scenes that are loaded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from animtool.scene.scene import Scene


def opened_sources(
    sources: Sequence[Path], variables: dict[str, str]
) -> list[Path | Scene]:
    """Return sources, those loaded that are scenes.

    Raises:
        OptionError: No scene uses a variable that is given.
    """
    from animtool.scene.sources import is_scene

    opened: list[Path | Scene] = []
    used: set[str] = set()
    for source in sources:
        if not is_scene(source):
            opened.append(source)
            continue
        from animtool.scene.file import load_scene

        scene = load_scene(source, variables)
        used |= scene.variables
        opened.append(scene)
    if variables:
        from animtool.documents.names import check_given

        check_given(variables, used)
    return opened


def until_pass(opened: list[Path | Scene], stop: str | None) -> list[Path | Scene]:
    """Return sources, the one scene among them without the passes behind one."""
    if stop is None:
        return opened
    scene = only_scene(opened)
    if scene is None:
        raise click.UsageError("--until is for a SOURCE that is one scene.")
    return [scene.until(stop)]


def only_scene(opened: Sequence[Path | Scene]) -> Scene | None:
    """Return the one source where it is a scene."""
    if len(opened) > 1 or isinstance(opened[0], Path):
        return None
    return opened[0]


def default_bake_output(source: Path | Scene) -> Path:
    """Return the file that a scene names, else the source's own name as usdc."""
    from animtool.scene.files import default_output

    if isinstance(source, Path):
        return default_output(source)
    return source.output or default_output(source.path)
