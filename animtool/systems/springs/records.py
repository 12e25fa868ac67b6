"""What is said of springs and of how to simulate them: in Python, and in files."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from animtool.core.array_types import ArrayLike
from animtool.core.options import Key, above, inherits_docs, or_more
from animtool.core.record import dataclass

# Of springs, and of the air.
_OfSpring = Annotated[float, or_more(0, "SIM042")]
_OfAir = Annotated[float, or_more(0, "SIM050")]


@inherits_docs
@dataclass(frozen=True, slots=True)
class Family:
    """What springs of a kind have in common.

    Attributes:
        stiffness: None is no force, unless another says it [N/m].
        damping: [N s/m].
        ratio: Of c = 2 ratio √(k m), on the mean mass m of both ends [1].
        axial_stiffness: Where it is given, `stiffness` is not used.
        frequency: Likewise: stiffness over the mean mass of both ends is (2 π f)².
    """

    stiffness: Annotated[
        float | None,
        or_more(0, "SIM042"),
        Key(
            "Force per elongation of each spring [N/m]. Default: set by another key.",
            1e4,
        ),
    ] = None
    damping: Annotated[
        _OfSpring, Key("Along the spring: force per speed [N s/m].", 0.5)
    ] = 0.0
    ratio: Annotated[
        _OfSpring,
        Key(
            "Additional damping, as a fraction of the critical damping of a single "
            "spring with its end masses.",
            0.1,
        ),
    ] = 0.0
    tear: Annotated[
        float | None,
        above(0, "SIM042"),
        Key(
            "Strain above which a spring tears. Default: never.",
            0.5,
        ),
    ] = None
    rest: Annotated[
        _OfSpring,
        Key(
            "Rest length relative to the built distance of the ends; 0 pulls them "
            "together.",
            0.9,
        ),
    ] = 1.0
    axial_stiffness: Annotated[
        float | None,
        or_more(0, "SIM042"),
        Key(
            "Instead of `stiffness`: force per strain [N], independent of the number "
            "of particles. Each spring gets it divided by its rest length.",
            5000,
        ),
    ] = None
    frequency: Annotated[
        float | None,
        or_more(0, "SIM042"),
        Key(
            "Instead of `stiffness`: natural frequency of a spring [Hz], whatever "
            "the masses of its ends.",
            10,
        ),
    ] = None


@inherits_docs
@dataclass(frozen=True, slots=True)
class Air:
    """Air that moves past the triangles of a body.

    A triangle of area A, through whose normal n air flows at u against it, bears
    ½ density A (drag |u·n| u + lift (u·n) (|u| n - (u·n) u/|u|)), its corners a third
    each.

    Attributes:
        wind: Velocity of the air ``(3,)``, or at the times ``(K, 3)`` [m/s].
        times: Ascending ``(K,)`` [s]; None where the wind is steady.
    """

    wind: ArrayLike = (0.0, 0.0, 0.0)
    drag: Annotated[_OfAir, Key("Drag coefficient along the flow.", 1.5)] = 1.0
    lift: Annotated[_OfAir, Key("Drag coefficient across the flow.", 0)] = 0.5
    density: Annotated[_OfAir, Key("Air density [kg/m³].", 0.9)] = 1.2
    times: ArrayLike | None = None


class Solver(StrEnum):
    """What takes springs through time.

    Attributes:
        AUTO: Semi-implicit Euler or BDF2, what is expected to take less time:
            steps, times their cost. XPBD where a surface keeps apart from itself.
        SYMPLECTIC_EULER: Semi-implicit Euler, in steps that the stiffest spring allows.
        XPBD: Extended position based dynamics in small steps: stable with any, and
            less accurate. It damps, and long chains hang lower than they are to.
        BDF2: Backward differences of two steps, for accuracy where springs are stiff.
        IMPLICIT_EULER: Implicit Euler: calm, and damps what its steps do not resolve.
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
        step: None leaves it to the solver: as many steps in each 1/240 s as it needs.
        stretch: Over the length at rest [1]; steps are halved where it is more.
        growth: Energy gained, in those of the start and what may be supplied, from
            which on a motion has blown up; of xpbd it is not asked for, and of bdf2 and
            implicit Euler not where there are colliders.
        longest: Length of a spring, in lengths at rest, from which on it has.
    """

    solver: Annotated[
        Solver | str,
        Key(
            "Time integration; `auto` chooses the cheapest that is stable and "
            "accurate enough, and reports why.",
            "xpbd",
            choices=tuple(map(str, Solver)),
        ),
    ] = Solver.AUTO
    step: Annotated[
        float | None,
        above(0, "SIM004", finite=True),
        Key("The longest step [s]. Default: what the solver needs.", 0.002),
    ] = None
    stretch: Annotated[
        float,
        above(0, "SIM004"),
        Key(
            "For `xpbd`: largest strain of springs beyond their own compliance.",
            0.005,
        ),
    ] = 0.01
    error: Annotated[
        float | None,
        above(0, "SIM004", finite=True),
        Key(
            "Largest position error [m]: steps are halved until two motions agree. "
            "Default: not checked.",
            0.001,
        ),
    ] = None
    growth: Annotated[float, above(0, "SIM004")] = 100.0
    longest: Annotated[float, above(1, "SIM004")] = 10.0


@inherits_docs
@dataclass(frozen=True, slots=True)
class SelfContact:
    """How a surface keeps apart from itself: cloth in folds, rolls and layers.

    At the end of each step, each particle is as far from each triangle as the cloth is
    thick, and each edge three quarters of that from each other edge, on the side that
    they were; Coulomb's friction takes from the way of one along the other. What one
    gains in momentum the other loses. Pairs that are nearer at rest keep that distance;
    along the surface they keep two thirds of it, so that the thickness is never more
    than springs leave room for.

    Limits of the method: what has gone through in spite of all, as where colliders
    close in on it, is remembered and brought back, but cloth that begins in a tangle
    stays in it (SIM166). Parts that go further over each other in one step than four
    thicknesses may go through unseen (SIM165): with colliders or pins that fast, take
    a shorter step.

    Attributes:
        speed: What comes apart keeps none of it.
        rest: Where particles are at rest ``(N, 3)`` [m]; None is where the body begins.

    References:
        M. Müller, B. Heidelberger, M. Hennix, J. Ratcliff, Position Based Dynamics,
        2007, sections 3.5 and 4.4. R. Bridson, R. Fedkiw, J. Anderson, Robust Treatment
        of Collisions, Contact and Friction for Cloth Animation, 2002, sections 6 and 7.
    """

    thickness: Annotated[
        float,
        above(0, "SIM045", finite=True),
        Key(
            "Minimum distance of its particles from its faces [m], such as half the "
            "edge length.",
            0.01,
        ),
    ]
    friction: Annotated[
        float, or_more(0, "SIM045", finite=True), Key("Coulomb's coefficient.", 0.4)
    ] = 0.2
    speed: Annotated[
        float,
        above(0, "SIM045", finite=True),
        Key("Speed at which parts that start closer are separated [m/s].", 0.1),
    ] = 0.2
    rest: ArrayLike | None = None
