"""The inputs of a batch: files that match patterns, or clips of a timeline.

A batch may override variables for the inputs that match other patterns.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from animtool.batch.cut_frames import CutOptions
from animtool.batch.cuts import Cut, CutList, read_cuts
from animtool.batch.spec import BatchSpec
from animtool.core.arguments import argument
from animtool.core.errors import Fault, NoMatchError, OptionError, Severity, listed
from animtool.core.files.reading import (
    MatchedFile,
    PathResolver,
    exists,
    is_pattern,
    matching_files,
    nearest_file,
)
from animtool.core.rates import rate_label
from animtool.core.readers import (
    BVH,
    FBX,
    GLTF,
    READERS,
    RIG_AND_CLIP_FILES,
    URDF,
    is_timeline,
)
from animtool.core.record import dataclass
from animtool.documents.document import Document

# Suffixes of files that are searched for in folders. USD is excluded: outputs are USD,
# and would be inputs of the next run.
INPUT_SUFFIXES = (
    *(suffix for suffix, reader in READERS.items() if reader in (BVH, GLTF, FBX, URDF)),
    *(
        f".clip{suffix}"
        for suffix, reader in READERS.items()
        if reader is RIG_AND_CLIP_FILES
    ),
)
SCENE_SUFFIXES = tuple(
    f".scene{suffix}"
    for suffix, reader in READERS.items()
    if reader is RIG_AND_CLIP_FILES
)


def cuts_of(spec: BatchSpec) -> CutList:
    """Return the media of the items: clips of a timeline, or the input files."""
    input_files, is_excluded, unmatched_warnings = _matched_inputs(spec)
    if spec.cuts is None:
        return CutList([Cut(file) for file in input_files], unmatched_warnings)
    options, start = spec.options, spec.options.start
    fps = options.fps
    if spec.scene is not None:
        from animtool.scene.file.read import stated_rate

        start, fps = None, stated_rate(spec.scene)
    if None not in {fps, spec.fps} and fps != spec.fps:
        assert fps is not None
        assert spec.fps is not None
        message = f"{argument('fps')} is {rate_label(spec.fps)}, but the scene has "
        message += rate_label(fps)
        raise OptionError(Fault("BAT051", message))
    if start is not None and start.denominator != 1:
        message = f"start is {float(start):g}, but shots begin at a whole frame"
        raise OptionError(Fault("CLI002", message))
    cut_options = CutOptions(
        None if start is None else int(start),
        spec.cut_start,
        spec.handles,
        spec.first_timecode,
        spec.fps or fps,
    )
    cut_list = read_cuts(spec.cuts, input_files, cut_options, is_excluded)
    return replace(cut_list, notices=[*cut_list.notices, *unmatched_warnings])


def _with_rate(spec: BatchSpec) -> BatchSpec:
    """Return a batch whose options have the frame rate of the command line.

    Raise CLI002 for options of timelines if the batch has no timeline.
    """
    refused_options = []
    if spec.cuts is None:
        if spec.cut_start is not None:
            refused_options.append(f"cut_start ({argument('cut_start')})")
        if spec.first_timecode is not None:
            refused_options.append("first_timecode")
        if spec.fps is not None and spec.scene is not None:
            refused_options.append(f"{argument('fps')} together with a scene")
    if refused_options:
        message = f"{listed(refused_options)}: only for a timeline, and the inputs "
        message += "contain none"
        raise OptionError(Fault("CLI002", message))
    if spec.fps is None or spec.scene is not None:
        return spec
    return replace(spec, options=replace(spec.options, fps=spec.fps))


def with_timeline_as_cuts(spec: BatchSpec) -> BatchSpec:
    """Return a batch whose cut list is the timeline among its inputs.

    The command line's frame rate applies to the cut list.
    """
    timelines = [text for text in spec.inputs if is_timeline(spec.folder / text)]
    if not timelines:
        return _with_rate(spec)
    all_timelines = [*([] if spec.cuts is None else [str(spec.cuts)]), *timelines]
    if len(all_timelines) > 1:
        message = f"the inputs contain several timelines: {listed(all_timelines)}"
        hint = "a batch takes the shots of one timeline"
        raise OptionError(Fault("BAT050", message, hint=hint))
    inputs = tuple(text for text in spec.inputs if text not in timelines)
    return _with_rate(replace(spec, cuts=spec.folder / timelines[0], inputs=inputs))


def _matched_inputs(
    spec: BatchSpec,
) -> tuple[list[MatchedFile], Callable[[Path], bool], list[Fault]]:
    """Return the distinct inputs, a test for excluded files, and warnings.

    There is a warning for each entry that matches no file.
    """
    suffixes = input_suffixes(spec)
    resolve_path = PathResolver()
    excluded_paths = {
        resolve_path(file.path)
        for pattern in spec.exclude
        for file in _match_files(spec.folder, pattern, suffixes)
    }
    files: dict[Path, MatchedFile] = {}
    unmatched_warnings = []
    for i, pattern in enumerate(spec.inputs):
        matched_files = _match_files(spec.folder, pattern, suffixes)
        remaining_files = {
            path: file
            for file in matched_files
            if (path := resolve_path(file.path)) not in excluded_paths
        }
        if not matched_files or _is_missing(pattern, remaining_files):
            unmatched_warnings.append(_unmatched_fault(spec, "inputs", i, suffixes))
        files = {**remaining_files, **files}
    # Globs that match nothing yet are usual among those that exclude.
    unmatched_warnings += [
        _unmatched_fault(spec, "exclude", i, suffixes)
        for i, pattern in enumerate(spec.exclude)
        if not is_pattern(pattern) and not exists(spec.folder / pattern)
    ]
    sorted_files = [files[path] for path in sorted(files, key=os.fspath)]
    return (
        sorted_files,
        lambda path: resolve_path(path) in excluded_paths,
        unmatched_warnings,
    )


def input_faults(spec: BatchSpec, document: Document) -> list[Fault]:
    """Return a warning for each entry without a file, and faults in the output."""
    files, _, unmatched_warnings = _matched_inputs(spec)
    shared_fault = shared_output_fault(spec, files)
    if shared_fault is None:
        return unmatched_warnings
    fault = document.fault(
        shared_fault.code, ("output",), shared_fault.message, shared_fault.hint
    )
    return [*unmatched_warnings, fault]


def shared_output_fault(spec: BatchSpec, files: Sequence[MatchedFile]) -> Fault | None:
    """Return a fault if several inputs have the same output (OUT007), else None.

    Shots and variants are compared with their outputs, when these are known.
    """
    output = spec.output
    has_several_items = len(files) > 1 and spec.cuts is None and spec.variants is None
    if (
        output is None
        or not has_several_items
        or "{" in output
        or not Path(output).suffix
    ):
        return None
    path, stems = Path(output), {file.path.stem for file in files}
    is_stem_unique = len(stems) == len(files)
    name = "{stem}" if is_stem_unique else "{parent}_{stem}"
    example = (path.parent / f"{path.stem}_{name}{path.suffix}").as_posix()
    message = f"output {output!r} is the same file for {len(files)} inputs"
    hint = f"name the input in it, such as {example!r}"
    return Fault("OUT007", message, spec.path_text, (), hint)


def _is_missing(pattern: str, matched_files: Mapping[Path, MatchedFile]) -> bool:
    """Return whether an entry names a single file that does not exist."""
    return (
        "://" not in pattern
        and len(matched_files) == 1
        and not exists(next(iter(matched_files)))
    )


def _unmatched_fault(
    spec: BatchSpec, key: str, index: int, suffixes: Sequence[str]
) -> Fault:
    text, path = getattr(spec, key)[index], spec.path_text
    hint = nearest_file(Path(text), spec.folder)
    if hint is None and (spec.folder / text).is_dir():
        hint = f"folders are searched for {', '.join(suffixes)}"
    message = f"no file matches {text!r}"
    if not is_pattern(text) and not (spec.folder / text).is_dir():
        message = f"{text!r} does not exist"
    return Fault(
        "BAT067", message, path, (), hint, Severity.WARNING, where=f"{key}[{index}]"
    )


def missing_inputs_error(spec: BatchSpec) -> NoMatchError:
    """Return the error for a batch without items (BAT005), with a hint."""
    if spec.cuts is not None:
        message = "has no clip with media"
        hint = "a clip without media uses the INPUT with its name: pass takes too"
        return NoMatchError(Fault("BAT005", message, str(spec.cuts), (), hint))
    suffixes = input_suffixes(spec)
    message = f"no input in {listed(spec.inputs) or 'nothing'}"
    hint = f"folders are searched for {', '.join(suffixes)}"
    file_hint = nearest_file(Path(spec.inputs[0]), spec.folder) if spec.inputs else None
    hint = _other_suffix_hint(spec, suffixes) or file_hint or hint
    return NoMatchError(Fault("BAT005", message, spec.path_text, (), hint))


def _other_suffix_hint(spec: BatchSpec, suffixes: Sequence[str]) -> str | None:
    """Return a hint if files match a pattern except for the suffix or its case."""
    for text in spec.inputs:
        stem, dot, suffix = text.rpartition(".")
        known_suffixes = [known_suffix.removeprefix(".") for known_suffix in suffixes]
        for other_suffix in (suffix.lower(), suffix.upper(), *known_suffixes):
            if not dot or other_suffix == suffix:
                continue
            pattern = f"{stem}.{other_suffix}"
            if _match_files(spec.folder, pattern, suffixes):
                return f"did you mean {pattern!r}?"
    return None


def input_suffixes(spec: BatchSpec) -> Sequence[str]:
    """Return the file suffixes that are searched for in folders."""
    return (
        INPUT_SUFFIXES if spec.scene is not None else (*INPUT_SUFFIXES, *SCENE_SUFFIXES)
    )


def _match_files(
    folder: Path, pattern: str, suffixes: Sequence[str]
) -> list[MatchedFile]:
    return list(matching_files(os.fspath(folder / pattern), suffixes))


@dataclass(frozen=True, slots=True)
class OverriddenVariables:
    """Variables that a batch overrides for some of its inputs."""

    values: Mapping[Path, Mapping[str, str]]  # by file path
    notices: tuple[Fault, ...]  # warnings about overrides that match no input


def resolve_overrides(
    spec: BatchSpec, files: Sequence[MatchedFile]
) -> OverriddenVariables:
    """Return the overridden variables of the inputs of a batch; the last match wins."""
    resolve_path = PathResolver()
    path_by_location = {resolve_path(file.path): file.path for file in files}
    suffixes = input_suffixes(spec)
    values_by_path: dict[Path, dict[str, str]] = {}
    notices = []
    for index, override in enumerate(spec.overrides):
        matched_locations = {
            resolve_path(file.path)
            for text in override.inputs
            for file in _match_files(spec.folder, text, suffixes)
        }
        overridden_inputs = path_by_location.keys() & matched_locations
        for location in overridden_inputs:
            values_by_path.setdefault(path_by_location[location], {}).update(
                override.variables
            )
        if not overridden_inputs:
            message = f"no input of the batch is {listed(override.inputs)}"
            hint = "inputs are files, folders and globs, relative to the batch file"
            where, warning = f"overrides[{index}].inputs", Severity.WARNING
            notices.append(
                Fault("BAT066", message, spec.path_text, (), hint, warning, where=where)
            )
    return OverriddenVariables(values_by_path, tuple(notices))
