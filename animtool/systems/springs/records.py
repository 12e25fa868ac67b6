"""Options of springs, air, solvers and self-contact, for Python and files."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from animtool.core.array_types import ArrayLike
from animtool.core.options import above, inherits_docs, key, or_more
from animtool.core.record import dataclass

# Ranges of spring and air options.
_SpringNumber = Annotated[float, or_more(0, "SIM042")]
_AirNumber = Annotated[float, or_more(0, "SIM050")]


@inherits_docs
@dataclass(frozen=True, slots=True)
class Family:
    """Properties of a family of springs.

    Attributes:
        stiffness: None is no force, unless another field sets it [N/m].
        damping: [N s/m].
        ratio: Damping c = 2 ratio √(k m), with the mean mass m of both ends [1].
        axial_stiffness: Replaces `stiffness`.
        frequency: Replaces `stiffness`, which is (2 π f)² times the mean end mass.
    """

    stiffness: Annotated[float | None, or_more(0, "SIM042")] = key(
        "Force per elongation of each spring [N/m]. Default: set by another key.",
        1e4,
        None,
    )
    damping: _SpringNumber = key("Along the spring: force per speed [N s/m].", 0.5, 0.0)
    ratio: _SpringNumber = key(
        "Additional damping, as a fraction of the critical damping of a single "
        "spring with its end masses.",
        0.1,
        0.0,
    )
    tear: Annotated[float | None, above(0, "SIM042")] = key(
        "Strain above which a spring tears. Default: never.", 0.5, None
    )
    rest: _SpringNumber = key(
        "Rest length relative to the built distance of the ends; 0 pulls them "
        "together.",
        0.9,
        1.0,
    )
    axial_stiffness: Annotated[float | None, or_more(0, "SIM042")] = key(
        "Instead of `stiffness`: force per strain [N], independent of the number "
        "of particles. Each spring gets it divided by its rest length.",
        5000,
        None,
    )
    frequency: Annotated[float | None, or_more(0, "SIM042")] = key(
        "Instead of `stiffness`: natural frequency of a spring [Hz], whatever "
        "the masses of its ends.",
        10,
        None,
    )


@inherits_docs
@dataclass(frozen=True, slots=True)
class Air:
    """Aerodynamic force on the triangles of a body.

    A triangle of area A with normal n and relative air velocity u gets the force
    ½ density A (drag |u·n| u + lift (u·n) (|u| n - (u·n) u/|u|)), a third on each
    corner.

    Attributes:
        wind: Velocity of the air ``(3,)``, or at the times ``(K, 3)`` [m/s].
        times: Ascending ``(K,)`` [s]; None for steady wind.
    """

    wind: ArrayLike = (0.0, 0.0, 0.0)
    drag: _AirNumber = key("Drag coefficient along the flow.", 1.5, 1.0)
    lift: _AirNumber = key("Drag coefficient across the flow.", 0, 0.5)
    density: _AirNumber = key("Air density [kg/m³].", 0.9, 1.2)
    times: ArrayLike | None = None


class Solver(StrEnum):
    """Time integrators of springs.

    Attributes:
        AUTO: Semi-implicit Euler or BDF2, whichever is expected to take less time.
            XPBD for surfaces with self-contact.
        SYMPLECTIC_EULER: Semi-implicit Euler, in steps that the stiffest spring allows.
        XPBD: Extended position based dynamics in small steps: unconditionally stable
            and less accurate. It damps, and long chains hang too low.
        BDF2: Two-step backward differences, accurate for stiff springs.
        IMPLICIT_EULER: Implicit Euler: damps motion that its steps do not resolve.
    """

    AUTO = "auto"
    SYMPLECTIC_EULER = "symplectic_euler"
    XPBD = "xpbd"
    BDF2 = "bdf2"
    IMPLICIT_EULER = "implicit_euler"


@inherits_docs
@dataclass(frozen=True, slots=True)
class SpringOptions:
    """How to simulate springs.

    Attributes:
        solver: Of `Solver`.
        step: None lets the solver choose the number of steps in each 1/240 s.
        stretch: Strain above which steps are halved [1].
        growth: Energy gain relative to the initial and supplied energy that counts as
            blow-up; not checked for xpbd, nor for implicit solvers with colliders.
        longest: Spring length, in rest lengths, that counts as blow-up.
        max_substeps: For xpbd: most steps in a cell; None is as many as float64 allows.
        clamped_strain: For xpbd: strain at which stiff springs are clamped in each
            step; 0 is never [1].
    """

    solver: Solver | str = key(
        "Time integration; `auto` chooses the cheapest that is stable and "
        "accurate enough, and reports why.",
        "xpbd",
        Solver.AUTO,
        choices=tuple(map(str, Solver)),
    )
    step: Annotated[float | None, above(0, "SIM004", finite=True)] = key(
        "The longest step [s]. Default: what the solver needs.", 0.002, None
    )
    stretch: Annotated[float, above(0, "SIM004")] = key(
        "For `xpbd`: largest strain of springs beyond their own compliance.",
        0.005,
        0.01,
    )
    error: Annotated[float | None, above(0, "SIM004", finite=True)] = key(
        "Largest position error [m]: steps are halved until two motions agree. "
        "Default: not checked.",
        0.001,
        None,
    )
    growth: Annotated[float, above(0, "SIM004")] = 100.0
    longest: Annotated[float, above(1, "SIM004")] = 10.0
    max_substeps: int | None = None
    clamped_strain: float = 0.0


@inherits_docs
@dataclass(frozen=True, slots=True)
class SelfContact:
    """Self-contact of a surface: cloth in folds, rolls and layers.

    At the end of each step, particles keep the thickness from triangles and edges keep
    three quarters of it from other edges, on the side where they were. Coulomb friction
    reduces sliding. Momentum is conserved. Pairs that are closer at rest keep that
    distance; along the surface they keep two thirds of it, so that the thickness never
    exceeds the space between particles.

    Limits of the method: piercing that happens anyway, for example between closing
    colliders, is tracked and undone, but cloth that starts in a tangle stays tangled
    (SIM166). Parts that slide past each other by more than four thicknesses in one step
    may pass through undetected (SIM165): use a shorter step for colliders or pins that
    fast.

    Attributes:
        speed: Separation adds no velocity.
        rest: Rest positions ``(N, 3)`` [m]; None is the start of the body.

    References:
        M. Müller, B. Heidelberger, M. Hennix, J. Ratcliff, Position Based Dynamics,
        2007, sections 3.5 and 4.4. R. Bridson, R. Fedkiw, J. Anderson, Robust Treatment
        of Collisions, Contact and Friction for Cloth Animation, 2002, sections 6 and 7.
    """

    thickness: Annotated[float, above(0, "SIM045", finite=True)] = key(
        "Minimum distance of its particles from its faces [m], such as half the "
        "edge length.",
        0.01,
    )
    friction: Annotated[float, or_more(0, "SIM045", finite=True)] = key(
        "Coulomb's coefficient.", 0.4, 0.2
    )
    speed: Annotated[float, above(0, "SIM045", finite=True)] = key(
        "Speed at which parts that start closer are separated [m/s].", 0.1, 0.2
    )
    rest: ArrayLike | None = None
