"""What processes need that make the items of a batch, by what the items are of."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module

from animtool.batch.recipe import Recipe
from animtool.readers import BVH, DOCUMENT, READERS, USD
from animtool.scene.sources import is_scene

# The last freezes what the others brought.
WARM = "animtool.batch.warm"
ALWAYS = ("animtool.batch.work", "animtool.scene.bake", "animtool.usd.author")
READING = {
    BVH: ("animtool.formats.bvh.read",),
    DOCUMENT: ("animtool.clip.file", "animtool.rig.file", "animtool.scene.clips"),
    USD: ("animtool.usd.read",),
}
LAYERS = ("animtool.usd.target",)
# A scene may read anything, and most change its time.
SCENES = (
    "animtool.scene.file",
    *(module for modules in READING.values() for module in modules),
    *LAYERS,
    "animtool.edit.loop",
    "animtool.edit.thin",
    "animtool.edit.trim",
    "animtool.scene.library",
    "animtool.scene.outputs",
    "animtool.usd.meshes",
)


def needed_modules(recipe: Recipe) -> list[str]:
    """Return what is imported before the first item; less is known of plug-ins.

    >>> from pathlib import Path
    >>> needed_modules(Recipe(kinds=(Path("walk.bvh"),)))[-2:]
    ['animtool.formats.bvh.read', 'animtool.batch.warm']
    """
    return [*dict.fromkeys([*ALWAYS, *_by_kind(recipe), WARM])]


def _by_kind(recipe: Recipe) -> Iterator[str]:
    if recipe.scene is not None or any(map(is_scene, recipe.kinds)):
        yield from SCENES
    if recipe.options.rig_layer is not None:
        yield from LAYERS
    for path in recipe.kinds:
        reader = READERS.get(path.suffix.lower())
        yield from READING.get(reader, ()) if reader is not None else ()


def import_needed(recipe: Recipe) -> None:
    """Import what is needed, where it is not there yet."""
    for name in needed_modules(recipe):
        import_module(name)
