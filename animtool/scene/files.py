"""The files that a bake writes, known before anything heavy is imported."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.documents.names import is_named
from animtool.scene.options import BakeOptions
from animtool.scene.sources import source_stem
from animtool.usd.forms import Form, output_paths

if TYPE_CHECKING:
    from animtool.scene.reading import Source


def bake_outputs(
    given: Sequence[Source], output: Path, options: BakeOptions
) -> list[Path]:
    """Return the files that a bake writes, ``output`` among them."""
    simulated = False
    if len(given) == 1 and not _is_take(given[0]):
        from animtool.scene.reading import found_sources

        reading = found_sources(given)
        options, _ = reading.options(options)
        written = (scene.writing(scene.outputs[0]) for scene in reading.scenes.values())
        simulated = any(scene.systems for scene in written)
    return output_files(output, options, simulated=simulated)


def _is_take(source: Source) -> bool:
    """Return whether a source is a file that says nothing of outputs."""
    return isinstance(source, Path | str) and not is_named(Path(source), "scene")


def default_output(source: Path) -> Path:
    """Return the file that a source is written to where none is named.

    >>> default_output(Path("takes/wave.scene.yaml")).name
    'wave.usdc'
    """
    return source.with_name(f"{source_stem(source)}.usdc")


def form_of(options: BakeOptions) -> Form:
    """Return what is written."""
    return Form(options.form or (Form.LAYER if options.rig_layer else Form.STAGE))


def output_files(
    path: Path, options: BakeOptions, *, simulated: bool = False
) -> list[Path]:
    """Return the files to write; of chunks, those that they may replace.

    simulated: whether systems are written.
    """
    files = output_paths(path, form_of(options))
    if options.chunk is None:
        return files
    from animtool.usd.chunks import point_files, system_files

    sets = [point_files(path)] if options.deform else []
    sets += [system_files(path)] if simulated else []
    chunks = [file for one in sets for file in (one.manifest, *one.there())]
    return [*files, *chunks]
