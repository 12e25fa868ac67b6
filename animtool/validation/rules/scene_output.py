"""What a scene writes, and over what."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from animtool.clip.points import joint_bounds
from animtool.documents.document import Location, read_document
from animtool.documents.variables import resolve_variables
from animtool.errors import AnimtoolError, Fault, OptionError
from animtool.scene.options import BakeOptions, check_options
from animtool.scene.outputs import scene_files
from animtool.scene.plan import take_name
from animtool.scene.schema import SceneModel
from animtool.scene.sources import SCENE_SUFFIXES
from animtool.validation.subjects.scene import SceneSubject


def over_input(subject: SceneSubject) -> Iterator[Fault]:
    """Yield outputs that are inputs too (SCN203)."""
    scene = subject.scene
    read = {*subject.read, *scene.inputs, scene.path}
    for at, output in subject.outputs:
        if output.path is None:
            continue
        layer = [output.bake.rig_layer] if output.bake.rig_layer else []
        inputs = {path.resolve() for path in (*read, *layer)}
        files = scene_files(replace(scene, outputs=(output,)), BakeOptions())
        over = [repr(path.name) for path in files if path.resolve() in inputs]
        if over:
            message = f"writes over {' and '.join(over)}, which it reads"
            yield subject.fault("SCN203", (*at, "file"), message, "name another")


def over_other(subject: SceneSubject) -> Iterator[Fault]:
    """Yield outputs that another scene of the folder writes too (SCN204).

    Takes of one library are not the same.
    """
    own = subject.scene.path.resolve()
    written = [
        (at, (output.path.resolve(), _take(subject.scene.path, output.bake)))
        for at, output in subject.outputs
        if output.path is not None
    ]
    for path in sorted(own.parent.iterdir()) if written else ():
        if path == own or not path.name.lower().endswith(SCENE_SUFFIXES):
            continue
        stat = path.stat()
        others = _outputs(path, stat.st_mtime_ns, stat.st_size)
        for at, output in written:
            if output in others:
                message = f"{path.name!r} writes {output[0].name!r} too"
                hint = "name another in one of them"
                yield subject.fault("SCN204", (*at, "file"), message, hint)


def _take(scene: Path, bake: BakeOptions) -> str:
    """Return the take of a library that is written; empty where it is a whole file."""
    return take_name(bake, scene) if bake.form == "library" else ""


@lru_cache(maxsize=4096)
def _outputs(path: Path, _changed: int, _size: int) -> tuple[tuple[Path, str], ...]:
    """Return the files and takes a scene writes, once a scene and version of it."""
    try:
        document = read_document(path)
        resolve_variables(document, SceneModel, {})
        document.check()
    except AnimtoolError:
        return ()
    written = document.value.get("output")
    entries = written if isinstance(written, list) else [written]
    return tuple(
        ((path.parent / name).resolve(), _take(path, _named_take(entry)))
        for entry in entries
        if isinstance(entry, dict) and isinstance(name := entry.get("file"), str)
    )


def _named_take(entry: dict[str, Any]) -> BakeOptions:
    """Return of an entry of outputs what says whether it is a take, and which."""
    form, take = entry.get("as"), entry.get("take")
    return BakeOptions(
        form="library" if form == "library" else None,
        take=take if isinstance(take, str) else None,
    )


def homeless(subject: SceneSubject) -> Iterator[Fault]:
    """Yield outputs whose folder is not there (SCN212)."""
    for at, output in subject.outputs:
        folder = None if output.path is None else output.path.parent
        if folder is None or folder.is_dir():
            continue
        how = "is no folder" if folder.exists() else "is not there"
        message = f"is to be written into {str(folder)!r}, which {how}"
        hint = "bake makes no folders: make it first"
        yield subject.fault("SCN212", (*at, "file"), message, hint)


def refused(subject: SceneSubject) -> Iterator[Fault]:
    """Yield options of the output that a bake refuses (SCN207)."""
    for at, output in subject.outputs:
        yield from _refused(subject, at, output.bake)


def _refused(subject: SceneSubject, at: Location, bake: BakeOptions) -> Iterator[Fault]:
    bounds = dict(bake.reduce_at)
    for key, check in (
        ((), lambda: check_options(bake, to_stdout=False)),
        (
            ("reduce_at",),
            lambda: joint_bounds(subject.take.rig, bake.reduce or 1.0, bounds),
        ),
    ):
        try:
            check()
        except OptionError as error:
            for fault in error.faults:
                place = (*at, *key)
                yield subject.fault("SCN207", place, fault.message, fault.hint)


def without_curves(subject: SceneSubject) -> Iterator[Fault]:
    """Yield curves that are to be kept, and that there are none of (SCN208)."""
    for at, output in subject.outputs:
        if output.bake.keep_curves and not subject.curves:
            message = "there is no control whose curve could be kept"
            hint = "clips have such curves; a pass that changes a control drops them"
            yield subject.fault("SCN208", (*at, "keep_curves"), message, hint)
