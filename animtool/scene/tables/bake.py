"""Time and size against error, over sample rates and tolerances, for one source."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

import numpy as np

from animtool.clip.reduction.points import SHELL, attached_points, point_errors
from animtool.clip.reduction.reduce import reduce_motion
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError
from animtool.core.rates import rate_label
from animtool.core.record import dataclass
from animtool.motion.take import Take
from animtool.rig.kinematics import WorldTransforms, forward, rest_size
from animtool.rig.skeleton import Rig
from animtool.scene.bake.bake import run_stage
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.plan import plan_stage
from animtool.scene.bake.reading import Source, source_file
from animtool.usd.rigs.skinned import played_world

# Sample rates over the source's own. A source of samples is exact at its own.
CURVE_RATES = (Fraction(1, 4), Fraction(1, 2), Fraction(1), Fraction(2), Fraction(4))
SAMPLE_RATES = (Fraction(1, 8), Fraction(1, 4), Fraction(1, 2), Fraction(1))
# Tolerances over the size of the skeleton, rounded down to a power of ten.
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
# Instants between two frames of a curve; samples at the highest rate have one between.
FINE = 8
# UsdSkel plays so many instants in about a second.
MAX_INSTANTS = 4000


class RowKind(StrEnum):
    """What a row tries: a rate, fewer samples of USD, or keys of a clip."""

    RATE = "rate"
    SAMPLES = "samples"
    KEYS = "keys"


@dataclass(frozen=True, slots=True)
class TableRow:
    """One setting and what it gives."""

    kind: RowKind  # what is tried
    setting: str  # rate or tolerance, in words
    count: int  # samples or keys written
    seconds: float  # wall time, of the whole bake or of the fit
    bytes: int  # size of the USD file; 0 where keys are fitted only
    # Largest distance from the source, in the world, of a joint or of a point 3 cm off
    # it [m].
    error: float
    joint: str
    time: float  # where that is [s from the first frame]


@dataclass(frozen=True, slots=True)
class BakeTable:
    """The rows for a source."""

    source: Path
    instants: int  # at how many times samples were compared
    rows: list[TableRow]  # in the order tried
    json_keys: ClassVar[str] = (
        "'table' source instants "
        "rows{kind setting count seconds~ bytes error=.{meters=error joint time}}"
    )


def bake_table(
    source: Source,
    options: BakeOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> BakeTable:
    """Bake a source in several ways, and measure what USD plays of each.

    Stages are written into a temporary folder and evaluated by UsdSkel, rounding and
    interpolation included. A clip is compared with its curves between the frames, a
    source of samples with these.
    """
    options = options or BakeOptions()
    plain = BakeOptions(source=options.source, to_up=options.to_up)
    truth, take = _truth(source, plain)
    rates = CURVE_RATES if truth.curved else SAMPLE_RATES
    size = rest_size(take.rig) or 1.0
    scale = 10.0 ** math.floor(math.log10(size))
    tolerances = [tolerance * scale for tolerance in TOLERANCES]
    trials = [
        (RowKind.RATE, rate_label(rate), replace(plain, fps=rate))
        for rate in (take.clock.rate * ratio for ratio in rates)
    ]
    thinning = replace(plain, reduce_at=options.reduce_at)
    trials += [
        (RowKind.SAMPLES, _millimetres(t), replace(thinning, reduce=t))
        for t in tolerances
    ]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, setting, result in trials:
            rows.append(_baked(source, Path(folder), result, kind, setting, truth))
            if progress is not None:
                progress(len(rows) / (len(trials) + len(tolerances)))
    for tolerance in tolerances:
        rows.append(_keyed(take, tolerance, dict(options.reduce_at)))
        if progress is not None:
            progress(len(rows) / (len(trials) + len(tolerances)))
    return BakeTable(source_file(source), len(truth.seconds), rows)


def _millimetres(meters: float) -> str:
    return f"{meters * 1000:g} mm"


@dataclass(frozen=True, slots=True)
class _Truth:
    """Where the joints of a source are at some instants [s]."""

    rig: Rig
    seconds: FloatArray
    world: WorldTransforms
    curved: bool


def _truth(source: Source, options: BakeOptions) -> tuple[_Truth, Take]:
    plan = plan_stage(source, None, options)
    if plan.options.deform:
        message = (
            f"{argument('table')} measures joints, and the scene writes deformed points"
        )
        raise OptionError(Fault("CLI002", message, str(source_file(source))))
    if not plan.takes:
        message = f"is simulated, and {argument('table')} measures joints"
        raise OptionError(Fault("SCN062", message, str(source_file(source))))
    stream = plan.takes[0].stream
    take = stream.collect()
    clock = take.clock
    curve = None if stream.altered else stream.curve
    per_frame = FINE if curve is not None else 1
    count = (clock.count - 1) * per_frame + 1
    picked = np.unique(
        np.linspace(0, count - 1, min(count, MAX_INSTANTS)).astype(np.int64)
    )
    frames = picked / per_frame
    if curve is None:
        motion = take.motion.select(picked)
    else:
        motion = curve(float(clock.start) + frames * float(clock.step))
    world = forward(take.rig, *motion.dense())
    seconds = frames / float(clock.rate)
    return _Truth(take.rig, seconds, world, curve is not None), take


def _baked(
    source: Source,
    folder: Path,
    options: BakeOptions,
    kind: RowKind,
    setting: str,
    truth: _Truth,
) -> TableRow:
    output = folder / f"{kind}.usdc"
    began = time.perf_counter()
    plan = plan_stage(source, output, replace(options, overwrite=True))
    # What is simulated beside the take has no joints to measure.
    result = run_stage(replace(plan, prims=plan.prims[:1], watch=None)).result
    seconds = time.perf_counter() - began
    codes = float(plan.start) + truth.seconds * float(plan.fps)
    world = played_world(output, codes)
    errors = point_errors(attached_points(truth.rig, SHELL), truth.world, world)
    at, joint = divmod(int(np.argmax(errors)), errors.shape[1])
    return TableRow(
        kind,
        setting,
        result.samples,
        seconds,
        result.bytes,
        float(errors[at, joint]),
        truth.rig.names[joint],
        float(truth.seconds[at]),
    )


def _keyed(take: Take, tolerance: float, others: dict[str, float]) -> TableRow:
    began = time.perf_counter()
    reduction = reduce_motion(take, tolerance, joint_tolerances=others)
    seconds = time.perf_counter() - began
    return TableRow(
        RowKind.KEYS,
        _millimetres(tolerance),
        reduction.keys,
        seconds,
        0,
        reduction.error,
        reduction.joint,
        reduction.frame / float(take.clock.rate),
    )
