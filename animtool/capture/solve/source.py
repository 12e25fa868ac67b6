"""A marker capture as a source of motion, solved window by window."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animtool.capture.options import SolveOptions
from animtool.capture.solve.run import MarkerSolve, solve_markers
from animtool.capture.templates.file import load_template
from animtool.capture.templates.template import MarkerTemplate
from animtool.core.arguments import argument, flag
from animtool.core.errors import Fault, OptionError, Severity, counted, faults_in
from animtool.core.units import LengthUnit, UpAxis, unit_name
from animtool.formats.marker_files import open_markers
from animtool.motion.driving import drive_stream
from animtool.motion.markers import Markers
from animtool.motion.motion import Motion
from animtool.motion.scores import PassScores, Score, ScoreUnit
from animtool.motion.take import TakeStream
from animtool.rig.placed import at_origin
from animtool.rig.skeleton import Rig

# Typical residual of a good solve, with skin motion [m], and outliers [1].
TYPICAL_RESIDUAL, TYPICAL_OUTLIERS = 0.005, 0.01


def open_markers_source(
    path: Path,
    *,
    rig: Path | None = None,
    template: Path | None = None,
    cameras: Path | None = None,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: Any = None,
    progress: Callable[[float], None] | None = None,
) -> TakeStream:
    """Open a file of markers as a take: its frames are solved as blocks are read.

    Args:
        path: Markers; with ``cameras``, pixel observations in an npz.
        rig: The rig to animate; None uses the rig named by the template.
        template: The markers' joints and offsets.
        cameras: Camera calibrations for triangulation.
        unit: Unit of the markers, or of the calibrations.
        up: The up axis of the same file.
        fps: The frame rate, if the file lacks one or its rate is wrong.
        progress: Called with the fraction done.
    """
    if cameras is None:
        markers = open_markers(path, unit=unit, up=up, fps=fps)
    else:
        markers = triangulate_source(path, cameras, unit=unit, up=up, fps=fps)
    if template is None:
        message = "holds markers, but no template places them on the rig"
        hint = f"to bake them, name one with {argument('source.template')}, or as "
        hint += "template: of a scene's source"
        if cameras is None:
            command = f"animtool mocap solve {path} {flag('template', 'FILE')} -o "
            command += f"{path.stem}.usdc"
            hint = f"first make a take of them: {command}; {hint}"
        raise OptionError(Fault("SOL007", message, str(path), (), hint))
    marker_template = load_template(template, rig)
    rig_path = rig_of_template(marker_template, rig, template)
    loaded_rig = at_origin(Rig.load(rig_path))
    with faults_in(path):
        solve = solve_markers(markers, loaded_rig, marker_template, SolveOptions())
    stream = solve_stream(solve, path, progress)
    stream.notices = [*loaded_rig.notices, *stream.notices]
    stream.details |= {"rig": str(rig_path), "template": str(template)}
    return stream


def rig_of_template(template: MarkerTemplate, rig: Path | None, path: Path) -> Path:
    """Return the given rig file, or the rig that the template names (else SOL008)."""
    if rig is not None:
        return rig
    if template.rig is not None:
        return template.rig
    message = "names no rig"
    hint = "write 'rig: hero.rig.yaml' into it, or pass a rig "
    hint += f"({argument('source.rig')})"
    raise OptionError(Fault("SOL008", message, str(path), (), hint))


def triangulate_source(
    path: Path,
    cameras: Path,
    *,
    unit: LengthUnit | None = None,
    up: UpAxis | None = None,
    fps: Any = None,
) -> Markers:
    """Triangulate pixel observations to markers; a note states the error (SOL106)."""
    from animtool.capture.cameras.file import load_all_cameras
    from animtool.capture.cameras.observations import read_observations
    from animtool.capture.cameras.triangulate import triangulate

    result = triangulate(
        read_observations(path, fps=fps), load_all_cameras([cameras], unit=unit, up=up)
    )
    error_text = f"reprojection {result.error_px:.3g} px ({result.error_mm:.3g} mm)"
    message = f"{counted(len(result.cameras), 'camera')}: {error_text}"
    summary_note = Fault("SOL106", message, str(path), severity=Severity.NOTE)
    return replace(result.markers, notices=(*result.notices, summary_note))


def solve_stream(
    solve: MarkerSolve, path: Path, progress: Callable[[float], None] | None
) -> TakeStream:
    """Wrap a solve as a take stream; notices and scores are complete after reading."""
    markers, rig = solve.markers, solve.model.rig
    clock = markers.clock
    stream = TakeStream(
        rig,
        clock.fps,
        clock.start,
        clock.step,
        iter(()),
        [fault.in_file(path) for fault in (*markers.notices, *solve.notices)],
    )

    def blocks() -> Iterator[Motion]:
        """Yield solved blocks; then add the solve's new notices and its scores."""
        known_count = len(solve.notices)
        yield from solve.blocks(progress)
        stream.notices += [fault.in_file(path) for fault in solve.notices[known_count:]]
        stream.scores.append(solve_scores(solve))

    stream.blocks = blocks()
    stream.blocks = drive_stream(stream).blocks
    stream.details = {
        "format": "markers",
        "units": unit_name(rig.meters_per_unit),
        "markers": counted(len(solve.model.joints), "marker"),
    }
    return stream


def solve_scores(solve: MarkerSolve) -> PassScores:
    """Return the mean marker error and the outlier fraction of a solve as scores."""
    score = solve.score
    outliers = float(np.mean([marker_score.outliers for marker_score in score.markers]))
    scores = (
        Score("marker", score.total, ScoreUnit.LENGTH, TYPICAL_RESIDUAL),
        Score("outliers", outliers, ScoreUnit.FRACTION, TYPICAL_OUTLIERS),
    )
    return PassScores(scores, pass_name="solve")
