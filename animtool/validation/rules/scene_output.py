"""What a scene writes, and over what."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from functools import lru_cache
from pathlib import Path

from animtool.clip.points import joint_bounds
from animtool.documents.document import read_document
from animtool.documents.variables import resolve_variables
from animtool.errors import AnimtoolError, Fault, OptionError
from animtool.scene.options import BakeOptions, check_options
from animtool.scene.schema import SceneModel
from animtool.scene.sources import SCENE_SUFFIXES
from animtool.validation.subjects.scene import SceneSubject

__all__ = ["over_input", "over_other", "refused", "without_curves"]


def over_input(subject: SceneSubject) -> Iterator[Fault]:
    """Yield outputs that are inputs too (SCN203)."""
    scene = subject.scene
    if scene.output is None:
        return
    from animtool.scene.plan import bake_outputs

    inputs = {path.resolve(): path for path in _inputs(subject)}
    for path in bake_outputs([scene], scene.output, BakeOptions()):
        if path.resolve() in inputs:
            message = f"writes over {path.name!r}, which it reads"
            yield subject.fault("SCN203", ("output", "file"), message, "name another")


def _inputs(subject: SceneSubject) -> Iterator[Path]:
    """Yield the files that a scene names to be read."""
    scene = subject.scene
    yield from (scene.path, scene.source)
    for path in (scene.options.rig, scene.bake.rig_layer):
        if path is not None:
            yield path
    for entry in scene.passes:
        for field in fields(entry.options):
            value = getattr(entry.options, field.name)
            if isinstance(value, Path):
                yield scene.path.resolve().parent / value


def over_other(subject: SceneSubject) -> Iterator[Fault]:
    """Yield outputs that another scene of the folder writes too (SCN204)."""
    scene = subject.scene
    if scene.output is None:
        return
    own, output = scene.path.resolve(), scene.output.resolve()
    for path in sorted(own.parent.iterdir()):
        if path == own or not path.name.lower().endswith(SCENE_SUFFIXES):
            continue
        stat = path.stat()
        if _output(path, stat.st_mtime_ns, stat.st_size) == output:
            message = f"{path.name!r} writes {scene.output.name!r} too"
            yield subject.fault(
                "SCN204", ("output", "file"), message, "name another in one of them"
            )


@lru_cache(maxsize=4096)
def _output(path: Path, _changed: int, _size: int) -> Path | None:
    """Return the file that a scene writes, once a scene and version of it."""
    try:
        document = read_document(path)
        resolve_variables(document, SceneModel, {})
        document.check()
    except AnimtoolError:
        return None
    written = document.value.get("output")
    name = written.get("file") if isinstance(written, dict) else None
    return (path.parent / name).resolve() if isinstance(name, str) else None


def refused(subject: SceneSubject) -> Iterator[Fault]:
    """Yield options of the output that a bake refuses (SCN207)."""
    bake = subject.scene.bake
    bounds = dict(bake.reduce_at)
    for key, check in (
        ("", lambda: check_options(bake, to_stdout=False)),
        (
            "reduce_at",
            lambda: joint_bounds(subject.take.rig, bake.reduce or 1.0, bounds),
        ),
    ):
        try:
            check()
        except OptionError as error:
            for fault in error.faults:
                at = ("output", key) if key else ("output",)
                yield subject.fault("SCN207", at, fault.message, fault.hint)


def without_curves(subject: SceneSubject) -> Iterator[Fault]:
    """Yield curves that are to be kept, and that there are none of (SCN208)."""
    if subject.scene.bake.keep_curves and not subject.curves:
        message = "there is no control whose curve could be kept"
        hint = "clips have such curves; a pass that changes a control drops its curve"
        at = ("output", "keep_curves")
        yield subject.fault("SCN208", at, message, hint)
