"""What cannot be simulated, found before the first step."""

from __future__ import annotations

import numpy as np

from animtool import _kernels
from animtool._types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.errors import Fault, OptionError, Severity, counted
from animtool.options import range_faults
from animtool.systems.springs.body import Body, Springs
from animtool.systems.springs.motion import warning
from animtool.systems.springs.paths import Pins, Targets
from animtool.systems.springs.records import SelfContact, Solver, SpringOptions

# Of many that are wrong in the same way, those that are named.
MAX_NAMED = 5


def check_body(body: Body, pins: Pins, targets: Targets | None) -> None:
    """Raise where particles, springs or what holds them make no sense.

    Raises:
        OptionError: A mass is not above 0 of a particle that is not held (SIM040); a
            position is not finite (SIM041); a spring joins what is not there or has an
            impossible number (SIM042); a pin or target is of a particle that is not
            there, or held twice (SIM043).
    """
    count = len(body.positions)
    held = _members(pins.particles)
    faults = _named("SIM041", "its position is not finite", _odd(body.positions))
    faults += _particle_faults(held, "pins", count)
    if len(np.unique(held)) < len(held):
        values, often = np.unique(held, return_counts=True)
        faults += _named("SIM043", "it is pinned twice", values[often > 1])
    if targets is not None:
        faults += _particle_faults(_members(targets.particles), "targets", count)
    free = np.ones(count, bool)
    free[held[(held >= 0) & (held < count)]] = False
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # What moves them is over their mass, which has to be a number, too.
        whole = np.isfinite(body.masses) & np.isfinite(1.0 / body.masses)
        light = ~((body.masses > 0) & whole) & free
    hint = "pin it, or give it a mass above 0"
    faults += _named("SIM040", "its mass is not above 0", np.flatnonzero(light), hint)
    faults += _spring_faults(body.springs, count)
    outside = ((body.triangles < 0) | (body.triangles >= count)).any(axis=1)
    faults += [
        Fault("SIM042", f"triangle {i} has a corner that is not there", where="body")
        for i in np.flatnonzero(outside)[:MAX_NAMED].tolist()
    ]
    if faults:
        raise OptionError(faults)


def check_limit(speed: float) -> None:
    """Raise where no speed of pins and targets would be below a limit.

    Raises:
        OptionError: It is not above 0 (SIM004).
    """
    if not speed > 0:
        message = f"speed_limit must be above 0, not {speed:g}"
        raise OptionError(Fault("SIM004", message, where="speed_limit"))


def check_path(
    name: str, positions: ArrayLike, times: ArrayLike | None, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return times ``(K,)`` and positions ``(K, count, 3)`` of a path.

    Raises:
        OptionError: They do not fit each other, or are not finite (SIM044).
    """
    path = np.array(positions, np.float64)
    moments = np.zeros(1) if times is None else np.asarray(times, np.float64)
    if times is None and path.shape == (count, 3):
        path = path[None]
    wanted = (*moments.shape, count, 3)
    message = ""
    if moments.ndim != 1 or not len(moments):
        message = f"times must be a list of at least one, not of shape {moments.shape}"
    elif path.shape != wanted:
        message = f"positions must have shape {wanted}, not {path.shape}"
    elif not np.isfinite(moments).all() or (np.diff(moments) <= 0).any():
        message = "times must be finite and ascend"
    elif not np.isfinite(path).all():
        row = int(np.argmin(np.isfinite(path).all(axis=(1, 2))))
        message = f"positions at {moments[row]:g} s are not finite"
    if message:
        raise OptionError(Fault("SIM044", message, where=name))
    return moments, path


def start_notices(body: Body) -> list[Fault]:
    """Return warnings of a start that springs make nothing of."""
    springs = body.springs
    gaps = body.positions[springs.ends[:, 1]] - body.positions[springs.ends[:, 0]]
    lost = int(((gaps == 0).all(axis=1) & (springs.rest > 0)).sum())
    if not lost:
        return []
    which = "every spring" if lost == len(gaps) else f"{lost} of {len(gaps)} springs"
    message = (
        f"the ends of {which} are at one place: with no direction they pull nothing "
        "until something parts them"
    )
    return [Fault("SIM140", message, where="body", severity=Severity.WARNING)]


def _members(particles: ArrayLike) -> IntArray:
    return np.asarray(particles, np.int64).reshape(-1)


def _odd(values: FloatArray) -> IntArray:
    return np.flatnonzero(~np.isfinite(values).all(axis=1))


def _named(
    code: str, message: str, particles: IntArray, hint: str | None = None
) -> list[Fault]:
    """Return a fault for each of the first particles of many."""
    faults = [
        Fault(code, f"particle {i}: {message}", where="body", hint=hint)
        for i in particles[:MAX_NAMED].tolist()
    ]
    more = len(particles) - MAX_NAMED
    if more > 0:
        faults.append(Fault(code, f"{more} more particles: {message}", where="body"))
    return faults


def _particle_faults(particles: IntArray, where: str, count: int) -> list[Fault]:
    lost = particles[(particles < 0) | (particles >= count)]
    message = f"there is no particle {{}}: they are 0 to {count - 1}"
    return [
        Fault("SIM043", message.format(i), where=where)
        for i in lost[:MAX_NAMED].tolist()
    ]


def _spring_faults(springs: Springs, count: int) -> list[Fault]:
    numbers = {
        "length at rest": springs.rest,
        "stiffness": springs.stiffness,
        "damping": springs.damping,
    }
    lost = (springs.ends < 0) | (springs.ends >= count)
    found: list[tuple[BoolArray, str]] = [
        (lost[:, 0] | lost[:, 1], "joins a particle that is not there"),
        (springs.ends[:, 0] == springs.ends[:, 1], "joins a particle to itself"),
    ]
    with np.errstate(invalid="ignore"):
        found += [
            (
                ~((values >= 0) & np.isfinite(values)),
                f"has a {name} that is not 0 or more",
            )
            for name, values in numbers.items()
        ]
        found.append((~(springs.limit >= springs.rest), "tears before it is stretched"))
    return [
        Fault("SIM042", f"spring {i} {message}", where="body")
        for bad, message in found
        for i in np.flatnonzero(bad)[:MAX_NAMED].tolist()
    ]


def check_self_contact(contact: SelfContact, body: Body) -> None:
    """Raise where a body cannot keep apart from itself in this way.

    Raises:
        OptionError: A number is out of its range, positions at rest do not fit, or the
            body has no triangles (SIM045), with every such fault.
    """
    messages = [fault.message for fault in range_faults(contact)]
    if not len(body.triangles):
        messages.append("a body without triangles does not keep apart from itself")
    if contact.rest is not None:
        rest = np.asarray(contact.rest, np.float64)
        if rest.shape != body.positions.shape:
            wanted = body.positions.shape
            messages.append(f"rest must have shape {wanted}, not {rest.shape}")
        elif not np.isfinite(rest).all():
            messages.append("rest must be finite")
    if messages:
        raise OptionError(
            [Fault("SIM045", message, where="self_contact") for message in messages]
        )


def tangle_notices(
    positions: FloatArray, triangles: IntArray, what: str = "the surface"
) -> list[Fault]:
    """Return a warning where a surface of points ``(N, 3)`` [m] is tangled (SIM166).

    >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1]])
    >>> points = np.append(points, [[0.2, 0.2, 1], [2, 2, 0]], axis=0)
    >>> (notice,) = tangle_notices(points, np.array([[0, 1, 2], [3, 4, 5]]))
    >>> notice.message
    'the surface begins in a tangle: its edges go through its triangles in 2 places'
    """
    pierced = _kernels.pierced_edges(
        np.ascontiguousarray(positions), np.ascontiguousarray(triangles, np.int64)
    )
    if not pierced:
        return []
    places = counted(pierced, "place")
    message = (
        f"{what} begins in a tangle: its edges go through its triangles in {places}"
    )
    hint = "what is through is not told from what is not: it may stay so"
    return [warning("SIM166", message, hint)]


def check_options(options: SpringOptions) -> Solver:
    """Return the solver that options name, and raise where they make no sense.

    Raises:
        OptionError: There is no such solver (SIM001), or a number is out of its range
            (SIM004).
    """
    faults = []
    names = [str(solver) for solver in Solver]
    if options.solver not in names:
        message = f"there is no solver {options.solver!r}"
        hint = f"they are {', '.join(names)}"
        faults.append(Fault("SIM001", message, where="solver", hint=hint))
    faults += range_faults(options)
    if faults:
        raise OptionError(faults)
    return Solver(options.solver)


def check_substeps(solver: Solver, rate: float, most: float) -> None:
    """Raise where a solver needs more steps a second than it may take.

    Raises:
        OptionError: It does (SIM004).
    """
    if rate <= most:
        return
    message = f"{solver} needs {rate:.3g} steps a second, and takes {most:.3g} at most"
    hint = "take xpbd or auto, less stiffness or damping, or more mass"
    raise OptionError(Fault("SIM004", message, where="solver", hint=hint))


def check_keeping_apart(wanted: Solver) -> None:
    """Raise where a solver does not keep a surface apart from itself.

    Raises:
        OptionError: It does not (SIM046).
    """
    if wanted in {Solver.AUTO, Solver.XPBD}:
        return
    message = f"{wanted} does not keep a surface apart from itself"
    hint = "take xpbd or auto"
    raise OptionError(Fault("SIM046", message, where="solver", hint=hint))
