"""The pass ``simulate``: what a rig attaches, moved by its joints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from fractions import Fraction
from pathlib import Path

from animtool.errors import Fault, OptionError
from animtool.motion import Motion
from animtool.passes import Pass, PassContext, Scope, TakePart
from animtool.systems.attach.bodies import Body, SurfaceBody, bodies_of
from animtool.systems.attach.report import notices_of, reports_of
from animtool.systems.attach.saved import Saved, read_states, write_states
from animtool.systems.attach.settings import SimulateOptions, option_checks
from animtool.systems.attach.simulation import Simulation
from animtool.take import TakeStream


def simulate(
    stream: TakeStream,
    options: SimulateOptions,
    folder: Path = Path(),
    *,
    early: int = 0,
    keeps: bool = True,
    progress: Callable[[float], None] | None = None,
) -> TakeStream:
    """Return a take whose rig's attachments move by themselves, block by block.

    Chains turn their joints. Cloth and strands get points of their own, which point
    caches are written of. Attachments of one call do not see each other: what hangs on
    another is for a call behind it.

    Args:
        stream: The take.
        options: What, and how.
        folder: Where relative paths start.
        early: Frames before the take's own that hold its first; no cycle has them.
        keeps: Whether states that the options ask for are saved.
        progress: Told the share done of each block, 0 to 1.

    Raises:
        FormatError: Arrays of the rig cannot be read any more or do not fit (RIG018,
            SKIN001 to SKIN006), or a file of states is none (SIM035).
        OptionError: An option makes no sense, with every such fault (SCN014, SCN015,
            SCN025, SIM030 to SIM032), the rig does not fit (SIM030, SIM033), or a
            file of states does not (SIM035).
    """
    _check(options)
    if not moves(options):
        return stream
    bodies = bodies_of(stream.rig, options.what)
    start = Fraction(1) if stream.start is None else stream.start
    simulation = Simulation(
        stream.rig,
        bodies,
        options,
        stream.fps / stream.step,
        start,
        stream.step,
        _resumed(bodies, options, folder),
        early,
        progress,
    )
    named = [body.mesh.name for body in bodies if isinstance(body, SurfaceBody)]
    return replace(
        stream,
        blocks=_blocks(simulation, stream, folder if keeps else None),
        points=stream.points | set(named),
    )


def _blocks(
    simulation: Simulation, stream: TakeStream, folder: Path | None
) -> Iterator[Motion]:
    yield from simulation.blocks(stream.blocks)
    if simulation.options.save and folder is not None:
        write_states(folder / simulation.options.save, simulation.saved)
    stream.notices.extend(notices_of(simulation))
    stream.simulated.extend(asdict(report) for report in reports_of(simulation))


def _resumed(
    bodies: Sequence[Body], options: SimulateOptions, folder: Path
) -> Saved | None:
    if options.resume is None:
        return None
    sizes = {body.name: body.network.count for body in bodies}
    return read_states(folder / options.resume, sizes)


def moves(options: SimulateOptions) -> bool:
    """Return whether there is anything to move, and any of it shown."""
    weight = options.weight
    keys = [(0.0, weight)] if isinstance(weight, (int, float)) else weight
    # Between keys of no weight there is none either.
    return bool(options.what) and any(value for _, value in keys)


def _check(options: SimulateOptions) -> None:
    faults: list[Fault] = []
    for name, check in option_checks(options).items():
        if name == "what" and not options.what:
            continue
        try:
            check()
        except OptionError as error:
            faults += error.faults
    if faults:
        raise OptionError(faults)


def _run(
    stream: TakeStream, options: SimulateOptions, context: PassContext
) -> TakeStream:
    return simulate(
        stream,
        options,
        context.folder,
        early=context.early,
        keeps=context.keeps,
        progress=context.progress,
    )


PASS = Pass(
    "simulate",
    "Let chains, cloth and strands of the rig move by themselves",
    SimulateOptions,
    Scope.WINDOW,
    _run,
    option_checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.SHAPES, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS, TakePart.POINTS}),
    settles=True,
    tells=True,
)
