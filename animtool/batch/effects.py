"""What inputs and variants of a batch have to do with its scenes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

from animtool.batch.cuts import SHOT_NAMES, Cut
from animtool.batch.names import INPUT_NAMES
from animtool.batch.recipe import Item, Recipe
from animtool.batch.spec import BatchSpec
from animtool.batch.variants import name_problems
from animtool.errors import Fault, OptionError, Severity, listed
from animtool.scene.sources import is_scene

if TYPE_CHECKING:
    from animtool.scene.reading import Source
    from animtool.scene.scene import Scene

MAX_FAULTS = 50


def sample_source(spec: BatchSpec, recipe: Recipe, shot: Cut) -> Source:
    """Return what the first item of an input is baked from."""
    names = {**shot.names, **spec.rows[0]}
    return recipe.source(Item(1, shot.found, shot.found.path, names, shot=shot.shot))


def check_columns(spec: BatchSpec) -> None:
    """Refuse columns of variants whose names mean something else.

    Raises:
        OptionError: With a fault for each (BAT063).
    """
    if spec.variants is None:
        return
    shots = () if spec.cuts is None else SHOT_NAMES
    taken = {*INPUT_NAMES, *shots, *spec.variables}
    path = spec.variants.path
    place, lines = (None, ()) if path is None else (str(path), (1,))
    hint = f"names of inputs, shots and --set have a meaning: {listed(sorted(taken))}"
    faults = [
        Fault("BAT063", message, place, lines, hint)
        for _, message in name_problems(spec.variants.names, taken)
    ]
    if faults:
        raise OptionError(faults)


def check_effects(spec: BatchSpec, recipe: Recipe, shots: Sequence[Cut]) -> None:
    """Refuse scenes of which all items, or all variants, would be the same.

    Raises:
        FormatError: A scene is malformed.
        OptionError: With a fault for each scene (BAT060).
    """
    kinds = {spec.scene or shot.found.path: shot for shot in reversed(shots)}
    names = () if spec.variants is None else spec.variants.names
    faults = []
    for path, shot in sorted(kinds.items()):
        if not is_scene(path):
            if names:
                message = "variants are of scenes, and this is none"
                hint = "--scene names a scene that uses ${input} and the variants"
                faults.append(Fault("BAT060", message, str(path), (), hint))
            continue
        if spec.scene is None and not names:
            continue
        scene = cast("Scene", sample_source(spec, recipe, shot))
        own = {*INPUT_NAMES, *(() if spec.cuts is None else SHOT_NAMES)}
        if spec.scene is not None and not scene.effective_variables & own:
            faults.append(_unused(scene, len(shots)))
        if names and not scene.effective_variables.intersection(names):
            used = ", ".join(f"${{{name}}}" for name in names)
            message = f"the scene uses none of the variants' names: {used}"
            hint = f"write {used.partition(',')[0]} in place of a value in it"
            faults.append(Fault("BAT060", message, str(path), (), hint))
    if faults:
        raise OptionError(faults[:MAX_FAULTS])


def _unused(scene: Scene, count: int) -> Fault:
    """Return the fault of a scene that does not use its inputs."""
    message = "the scene does not use its input"
    if count > 1:
        message += f": all {count} items would be the same"
    hint = "write `file: ${input}` in its source"
    if scene.sources:
        return scene.sources[0].place.fault("BAT060", message, hint, Severity.ERROR)
    return Fault("BAT060", message, str(scene.path), (), hint)
