"""An example of every kind of system, small and nasty."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from animtool.maths import so3
from support.simulated import (
    Array,
    Bursts,
    Length,
    Point,
    Rotation,
    Spans,
    Timed,
    Vector,
)

TILT = so3.exp(np.array([0.3, -0.2, 0.5]))
TILTED = Rotation(TILT[[3, 0, 1, 2]].tolist())
OFFSET = np.array([3.0, -1.0, 2.0])
# What holds or makes it goes there and back, faster at the end.
MOVES = Timed([[0, 0, 0, 0], [0.125, 0.1, 0.02, 0], [0.375, -0.1, 0.1, 0.2]])
# A tilted floor that rises, below what falls.
FLOOR = {
    "shape": {"plane": {}},
    "at": Point(np.add(OFFSET, [0.0, -0.3, 0.0])),
    "rotate": TILTED,
    "moves": Timed([[0, 0, 0, 0], [0.5, 0, 0.2, 0]]),
    "depenetration": Length(1.0),
    "speed_limit": Length(200.0),
    "friction": 0.3,
}
GRAVITY = Vector([1.0, -9.0, 0.5])


@dataclass(frozen=True)
class Example:
    """A system of a kind.

    Attributes:
        keys: Its entry.
        few: Changes that leave as little as there can be, and how many points there
            are then.
        wild: Changes with which it blows up, unless it is `bounded`.
        initial: Its points at 0 s ``(N, 3)`` [m].
        orders: Orders of methods, in step.
        more: Methods without an order, or with one only where all is smooth.
        smooth: Changes without which no order shows.
        bounded: Its numbers stay finite whatever the keys are.
        moving: Its first state has velocities.
    """

    keys: dict[str, Any]
    few: tuple[tuple[dict[str, Any], int], ...]
    wild: dict[str, Any]
    initial: np.ndarray
    orders: dict[str, int]
    more: tuple[str, ...] = ()
    smooth: dict[str, Any] = field(default_factory=dict)
    bounded: bool = False
    moving: bool = False


def springs(**keys: Any) -> dict[str, Any]:
    """Return keys that all kinds of springs have, and those of one."""
    return {
        "mass": 0.1,
        "gravity": GRAVITY,
        "drag": 0.7,
        "radius": Length(0.01),
        "colliders": [FLOOR],
        "speed_limit": Length(200.0),
        "step": 1 / 512,
        "solver": "symplectic_euler",
        **keys,
    }


BREEZE = {
    "velocity": Vector([1.0, 0.5, 2.0]),
    "gusts": Timed([[0, 0, 0, 0], [0.25, 2.0, 0, 1]]),
}
AIR = {**BREEZE, "density": Length(1.2, -3)}
FAMILY = {"stiffness": 60, "ratio": 0.1}
LINES = {"structural": FAMILY, "bend": {"stiffness": 4, "ratio": 0.1}}
ORDERS = {"symplectic_euler": 1, "implicit_euler": 1, "bdf2": 2}
SOLVERS = ("auto", "xpbd")
# Too stiff for the step, whatever is done.
WILD = {"structural": {"stiffness": 1e9}}
SMOOTH = {"colliders": [], "pins": [{"particles": [0]}]}

ROPE = np.linspace(OFFSET, np.add(OFFSET, [0.6, 0.1, -0.2]), 5)
HAIR = ROPE[None, :4] + np.array([[0, 0, 0], [0.1, 0, 0.2], [-0.1, 0.05, 0.2]])[:, None]
ACROSS, UP = np.array([0.5, 0.0, 0.1]), np.array([0.0, -0.1, 0.4])
SHEET = np.array(
    [OFFSET + i / 3 * ACROSS + j / 2 * UP for j in range(3) for i in range(4)]
)
# Two tetrahedra that share a face.
JELLY = OFFSET + np.array(
    [[0, 0, 0], [0.3, 0, 0.1], [0, 0.3, 0], [0, 0.05, 0.3], [0.3, 0.3, 0.35]]
)
CELLS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])

# Five that see some of each other, and go ahead of a way and across it.
SHOAL = OFFSET + np.array(
    [[0.1, 0, 0], [0.4, 0.2, 0.1], [0.2, -0.1, 0.5], [0.7, 0.1, 0.2], [0.3, 0.3, 0.3]]
)
SWIMMING = np.array(
    [[1.0, 0.1, 0.2], [1.2, -0.3, 0], [0.8, 0.2, 0.6], [1.1, 0, -0.4], [1.3, 0.2, 0.1]]
)

# Five at rest that fall towards each other, and past what goes by.
CLUSTER = OFFSET + np.array(
    [[0, 0, 0], [0.5, 0.1, 0], [0.1, -0.4, 0.2], [-0.3, 0.2, 0.4], [0.2, 0.5, -0.3]]
)

# Ions and atoms at rest in a box about the same place, drawn by what goes by.
IONS = OFFSET + so3.rotate(
    TILT,
    np.array(
        [
            [-1.05, 0, 0],
            [-0.75, 0.1, 0.1],
            [0, 0.7, -0.6],
            [1.0, 0.9, 0.1],
            [1.02, 0.4, -0.1],
        ]
    ),
)

# Eight drops, nearly on a lattice, that fall on a floor.
DROPS = OFFSET + 0.1 * np.array(
    [[x, y, z] for x in (0.0, 1.02) for y in (0.1, 0.97) for z in (-0.03, 1.0)]
)

DOOR = np.add(OFFSET, [0.3, 0.6, 0.2])


def on_floor(*places: tuple[float, float]) -> np.ndarray:
    """Return places of a tilted ground by their x and z there ``(K, 3)`` [m]."""
    return OFFSET + so3.rotate(TILT, np.array([[x, 0.0, z] for x, z in places]))


# Five of whom two meet, two go together and one is in the way.
WALKERS = on_floor((0, 0), (0.1, 1.2), (-0.6, 0.4), (-0.7, 1.0), (0.5, 0.6))

EXAMPLES = {
    "particles": Example(
        {
            "emitters": [
                {
                    "place": {"disc": {"radius": Length(0.2)}},
                    "at": Point(OFFSET),
                    "rotate": TILTED,
                    "moves": MOVES,
                    "turns": Timed([[0, 1, 0, 0, 0], [0.25, 0.8, 0.6, 0, 0]]),
                    "bursts": Bursts([[0, 3], [0.0625, 5], [0.3, 2]]),
                    "speed": Length(1.5),
                    "speed_spread": Length(0.5),
                    "spread": 40,
                    "lifetime": 0.4,
                    "lifetime_spread": 0.1,
                    "radius": Length(0.01),
                    "radius_spread": Length(0.004),
                    "mass": 0.1,
                    "seed": 3,
                }
            ],
            "forces": [
                {"gravity": {"acceleration": GRAVITY}},
                {"drag": {"linear": 0.02, "quadratic": Length(0.01, -1)}},
                {"wind": {"velocity": Vector([1.0, 0.5, 2.0]), "drag": 0.05}},
                {
                    "spring": {
                        "anchor": Point(np.add(OFFSET, [0, 0.5, 0])),
                        "k": 1.0,
                        "kd": 0.1,
                    }
                },
            ],
            "colliders": [
                {
                    **FLOOR,
                    "at": Point(np.add(OFFSET, [0.0, -0.05, 0.0])),
                    "restitution": 0.4,
                }
            ],
            "kill": [
                {
                    "shape": {"box": {"size": [Length(9.0)] * 3}},
                    "at": Point(OFFSET),
                    "container": True,
                }
            ],
            "step": 1 / 128,
        },
        few=(
            ({"emitters": [{"rate": 1, "start": 9}]}, 0),
            ({"emitters": [{"bursts": [[0, 1]], "mass": 0.1}]}, 1),
        ),
        wild={"forces": [{"spring": {"anchor": [0, 0, 0], "k": 1e9}}]},
        initial=np.zeros((0, 3)),
        orders={"euler": 1, "midpoint": 2, "rk4": 4},
        more=("velocity_verlet", "rk45"),
        smooth={
            "colliders": [],
            "kill": [],
            "emitters": [
                {"at": OFFSET.tolist(), "bursts": [[0, 2]], "speed": 1.5, "mass": 0.1}
            ],
        },
    ),
    "crowds": Example(
        {
            "ground": {"at": Point(OFFSET), "rotate": TILTED},
            "goals": [
                {
                    "name": "far",
                    "at": Point(on_floor((0.1, 3.0))[0]),
                    "radius": Length(0.2),
                },
                {
                    "name": "near",
                    "at": Point(on_floor((0.0, -2.0))[0]),
                    "radius": Length(0.2),
                    "wait": 0.1,
                    "queue": {
                        "direction": Vector(so3.rotate(TILT, np.array([1.0, 0, 0]))),
                        "spacing": Length(0.6),
                    },
                },
            ],
            "populations": [
                {
                    "name": "up",
                    "points": Point(WALKERS[[0, 2, 3]]),
                    "route": ["far", "near"],
                    "then": "repeat",
                    "group": 2,
                    "speed": {"mean": Length(1.3), "spread": Length(0.2)},
                    "radius": Length(0.15),
                    "height": Length(1.7),
                },
                {
                    "name": "down",
                    "points": Point(WALKERS[[1, 4]]),
                    "route": ["near"],
                    "speed": {"mean": Length(1.2), "spread": Length(0.1)},
                    "radius": Length(0.2),
                    "height": Length(1.6),
                    "delay": 0.2,
                },
            ],
            "doors": [
                {
                    "begin": Point(on_floor((-1.0, -0.3))[0]),
                    "end": Point(on_floor((1.0, -0.4))[0]),
                    "opens": Spans([[0.3, 9.0]]),
                }
            ],
            "avoidance": {
                "sight": Length(3.0),
                "space": Length(0.2),
                "push": Length(0.3),
            },
            "colliders": [
                {
                    **FLOOR,
                    "shape": {"sphere": {"radius": Length(0.3)}},
                    "at": Point(on_floor((0.5, -0.1))[0]),
                    "moves": MOVES,
                }
            ],
            "step": 1 / 64,
        },
        few=(
            ({"populations": [{"name": "up", "count": 0}]}, 0),
            (
                {
                    "populations": [
                        {"name": "up", "points": Point(WALKERS[:1]), "route": ["far"]}
                    ]
                },
                1,
            ),
        ),
        wild={
            "populations": [
                {
                    "name": "up",
                    "points": Point(WALKERS[:2]),
                    "route": ["far"],
                    "speed": {"mean": 1e18, "most": 1e18},
                    "radius": 1e9,
                }
            ]
        },
        bounded=True,
        initial=WALKERS[[0, 2, 3, 1, 4]],
        orders={},
    ),
    "flocks": Example(
        {
            "species": [
                {
                    "name": "fish",
                    "points": Point(SHOAL),
                    "velocities": Array(SWIMMING),
                    "radius": Length(0.02),
                    "mass": 0.1,
                    "vision": {"radius": Length(1.1), "angle": 270, "nearest": 3},
                    "repulsion": {
                        "weight": Length(0.15, 2),
                        "softening": Length(0.1),
                    },
                    "speed": {
                        "cruise": Length(1.5),
                        "weight": Length(0.2, -2),
                        "most": Length(2.5),
                    },
                    "turning": 400,
                    "acceleration": Length(30.0),
                    "goals": [
                        {
                            "at": Point(np.add(OFFSET, [0, 0.5, 0])),
                            "weight": 0.5,
                            "radius": Length(0.1),
                            "moves": MOVES,
                        }
                    ],
                    "paths": [
                        {
                            "points": [Point(p) for p in ROPE],
                            "ahead": Length(0.2),
                        }
                    ],
                    "avoidance": {
                        "distance": Length(0.9),
                        "weight": Length(10.0),
                    },
                    "flees": [
                        {
                            "species": "pike",
                            "weight": Length(2.0, 2),
                            "radius": Length(2.0),
                        }
                    ],
                },
                {
                    "name": "pike",
                    "points": Point(np.add(OFFSET, [[1.0, 0.2, 0.3]])),
                    "velocities": Array(np.array([[-1.0, 0.1, 0.2]])),
                    "radius": Length(0.05),
                    "vision": {"radius": Length(1.0)},
                    "repulsion": {"weight": 0, "softening": Length(0.1)},
                    "speed": {
                        "cruise": Length(1.2),
                        "weight": Length(0.2, -2),
                        "most": Length(3.0),
                    },
                    "avoidance": {
                        "distance": Length(0.9),
                        "weight": Length(10.0),
                    },
                    "chases": [{"species": "fish", "weight": 2, "radius": Length(3.0)}],
                },
            ],
            "forces": [
                {"gravity": {"acceleration": Vector([0.2, -0.5, 0.1])}},
                {"wind": {"velocity": Vector([1.0, 0.5, 2.0]), "drag": 0.05}},
            ],
            # Near enough to be avoided, too far to be touched.
            "colliders": [{**FLOOR, "at": Point(np.add(OFFSET, [0, -0.8, 0]))}],
            "step": 1 / 128,
        },
        few=(
            ({"species": [{"name": "fish", "count": 0}]}, 0),
            ({"species": [{"name": "fish", "count": 1}]}, 1),
        ),
        wild={"forces": [{"spring": {"anchor": [0, 0, 0], "k": 1e9}}]},
        bounded=True,
        initial=np.concatenate([SHOAL, np.add(OFFSET, [[1.0, 0.2, 0.3]])]),
        orders={"symplectic_euler": 1, "midpoint": 2, "rk4": 4},
        more=("velocity_verlet",),
        smooth={
            "colliders": [],
            "species": [
                {
                    "name": "fish",
                    "points": Point(SHOAL),
                    "velocities": Array(SWIMMING),
                    "vision": {"radius": 9},
                    "goals": [{"at": OFFSET.tolist(), "weight": 2}],
                    "speed": {"most": 9},
                }
            ],
        },
        moving=True,
    ),
    "fluid": Example(
        {
            "spacing": Length(0.1),
            "fills": [{"points": Point(DROPS)}],
            "emitters": [
                {
                    "at": Point(np.add(OFFSET, [0.6, 0.2, 0.1])),
                    "rotate": TILTED,
                    "moves": MOVES,
                    "size": [Length(0.1), Length(0.1)],
                    "speed": Length(1.6),
                    "opens": Spans([[0.03125, 0.1875], [0.3125, 9.0]]),
                }
            ],
            "drains": [
                {
                    "shape": {"box": {"size": [Length(3.0)] * 3}},
                    "at": Point(OFFSET),
                    "container": True,
                }
            ],
            "viscosity": Length(0.01, 2),
            "density": Length(1000.0, -3),
            "tension": 2.0,
            "forces": [
                {"gravity": {"acceleration": GRAVITY}},
                {"wind": {"velocity": Vector([1.0, 0.5, 2.0]), "drag": 0.2}},
            ],
            "colliders": [{**FLOOR, "at": Point(np.add(OFFSET, [0.0, -0.2, 0.0]))}],
            "primvars": ["pressure"],
            "step": 1 / 128,
        },
        few=(
            ({"fills": [], "emitters": [{"radius": 0.1, "opens": [[9, 9]]}]}, 0),
            (
                {
                    "fills": [{"points": Point(DROPS[:1])}],
                    "emitters": [],
                    "drains": [],
                    "colliders": [],
                },
                1,
            ),
        ),
        wild={"forces": [{"spring": {"anchor": [0, 0, 0], "k": 1e9}}]},
        initial=DROPS,
        orders={},
    ),
    "molecules": Example(
        {
            "species": [
                {
                    "name": "sodium",
                    "points": Point(IONS[[0, 3]]),
                    "charge": 0.5,
                    "mass": 22.99,
                    "sigma": 0.25,
                    "epsilon": 0.4,
                    "radius": Length(0.1),
                },
                {"name": "chlorine", "points": Point(IONS[[1, 4]]), "charge": -0.5},
                {"name": "argon", "points": Point(IONS[[2]])},
            ],
            "box": [2.2, 2.0, 2.4],
            "at": Point(OFFSET),
            "rotate": TILTED,
            "scale": Length(1.0),
            "pace": 2,
            "thermostat": {"temperatures": Bursts([[0, 50], [0.3, 400]])},
            "traps": [
                {
                    "at": Point(np.add(OFFSET, [0, 0.5, -0.6])),
                    "stiffness": 400,
                    "moves": MOVES,
                }
            ],
            "colour": {"by": "energy"},
            "seed": 3,
            "step": 1 / 256,
        },
        few=(
            (
                {
                    "species": [
                        {
                            "name": "argon",
                            "points": Point(IONS[:1]),
                            "velocities": Array(np.array([[0.1, 0, 0.2]])),
                        }
                    ]
                },
                1,
            ),
        ),
        wild={"species": [{"name": "argon", "count": 5}], "temperature": 1e14},
        initial=IONS[[0, 3, 1, 4, 2]],
        orders={"symplectic_euler": 1, "velocity_verlet": 2},
        more=("position_verlet", "rk4"),
        smooth={"thermostat": None, "traps": []},
    ),
    "nbody": Example(
        {
            "bodies": [
                {"points": Point(CLUSTER[:3]), "mass": 0.5, "radius": Length(0.02)},
                {"points": Point(CLUSTER[3:]), "mass": 0.2},
            ],
            "attractors": [
                {
                    "mass": 2,
                    "at": Point(np.add(OFFSET, [1.0, 0, 0])),
                    "softening": Length(0.1),
                    "moves": MOVES,
                }
            ],
            "gravity_constant": Length(1.0, 3),
            "softening": Length(0.1),
            "colour": {"by": "speed"},
            "step": 1 / 128,
        },
        few=(
            (
                {
                    "bodies": [
                        {
                            "points": Point(CLUSTER[:1]),
                            "velocities": Array(np.array([[0.1, 0, 0.2]])),
                        }
                    ],
                    "attractors": [],
                },
                1,
            ),
        ),
        wild={"attractors": [{"mass": 1e18, "softening": 1e-3}]},
        initial=CLUSTER,
        orders={"symplectic_euler": 1, "midpoint": 2, "velocity_verlet": 2, "rk4": 4},
        more=("position_verlet", "rk45"),
        smooth={"attractors": []},
    ),
    "rigid": Example(
        {
            "bodies": [
                {
                    "name": "crate",
                    "shapes": [
                        {
                            "shape": {
                                "box": {"size": [Length(x) for x in (0.3, 0.2, 0.1)]}
                            }
                        },
                        {
                            "shape": {"sphere": {"radius": Length(0.05)}},
                            "at": [Length(0.1), Length(0.15), 0],
                        },
                    ],
                    "density": Length(500.0, -3),
                    "at": Point(OFFSET),
                    "rotate": TILTED,
                    "pushes": [
                        {
                            "force": Vector([3.0, 20.0, -9.0]),
                            "at": [Length(0.1), 0, Length(0.05)],
                        }
                    ],
                },
                {
                    "name": "door",
                    "shape": {"box": {"size": [Length(x) for x in (0.4, 0.02, 0.3)]}},
                    "mass": 2,
                    "at": Point(DOOR),
                    "rotate": TILTED,
                },
                {
                    "name": "stone",
                    "shape": {"sphere": {"radius": Length(0.1)}},
                    "mass": 1,
                    "at": Point(np.add(OFFSET, [-0.5, -0.15, 0.3])),
                },
            ],
            "joints": [
                {
                    "type": "ball",
                    "body": "door",
                    "at": Point(np.add(DOOR, [0.2, 0.1, 0])),
                    "rotate": TILTED,
                    "moves": MOVES,
                    "swing": 70,
                    "drive": {
                        "stiffness": Length(2.0, 2),
                        "damping": Length(0.1, 2),
                        "rotation": [0.9, 0.2, 0.1, 0.3],
                    },
                }
            ],
            "forces": [
                {"gravity": {"acceleration": GRAVITY}},
                {"wind": {"velocity": Vector([1.0, 0.5, 2.0]), "drag": 0.5}},
            ],
            "colliders": [FLOOR],
            "residual": Length(1e-13),
            "iterations": 20,
            "sleep": {"speed": Length(0.02)},
            "step": 1 / 128,
        },
        few=(
            (
                {
                    "bodies": [{"name": "dot", "shape": {"sphere": {"radius": 0.1}}}],
                    "joints": [],
                },
                1,
            ),
        ),
        wild={"forces": [{"spring": {"anchor": [0, 0, 0], "k": 1e17}}]},
        initial=np.stack([OFFSET, DOOR, np.add(OFFSET, [-0.5, -0.15, 0.3])]),
        orders={"splitting": 2, "rk4": 2},
        more=("symplectic_euler", "explicit_euler"),
        smooth={
            "bodies": [
                {
                    "name": "top",
                    "shape": {"box": {"size": [0.4, 0.2, 0.1]}},
                    "at": OFFSET.tolist(),
                    "spin": [900, 400, -700],
                    "velocity": np.cross(
                        np.radians([900, 400, -700]), [-0.2, -0.2, -0.2]
                    ).tolist(),
                }
            ],
            "joints": [
                {"type": "ball", "body": "top", "at": np.add(OFFSET, 0.2).tolist()}
            ],
            "colliders": [],
        },
    ),
    "rope": Example(
        springs(
            **{"from": Point(ROPE[0]), "to": Point(ROPE[-1])},
            count=5,
            tip_mass=0.2,
            springs=LINES,
            wind=BREEZE,
            pins=[
                {"particles": ["start"], "moves": MOVES},
                {"particles": ["end"], "stiffness": 5, "damping": 0.1},
            ],
        ),
        few=(({"count": 2, "pins": []}, 2),),
        wild={"springs": WILD},
        initial=ROPE,
        orders=ORDERS,
        more=SOLVERS,
        smooth=SMOOTH,
    ),
    "strands": Example(
        springs(
            points=Point(HAIR),
            springs=LINES,
            wind=BREEZE,
            pins=[{"particles": ["roots"], "moves": MOVES}],
        ),
        few=(({"points": Point(HAIR[:1, :2]), "pins": []}, 2),),
        wild={"springs": WILD},
        initial=HAIR.reshape(-1, 3),
        orders=ORDERS,
        more=SOLVERS,
        smooth=SMOOTH,
    ),
    "cloth": Example(
        springs(
            corner=Point(OFFSET),
            across=Vector(ACROSS.tolist()),
            up=Vector(UP.tolist()),
            resolution=[4, 3],
            springs={
                "structural": FAMILY,
                "diagonals": {"stiffness": 20, "ways": "one"},
                "bend": {"stiffness": 2},
            },
            wind=AIR,
            pins=[{"particles": ["left"], "moves": MOVES}],
        ),
        few=(({"resolution": [2, 2], "pins": []}, 4),),
        wild={"springs": WILD},
        initial=SHEET,
        orders=ORDERS,
        more=SOLVERS,
        smooth=SMOOTH,
    ),
    "volume": Example(
        springs(
            tetrahedra={"points": Point(JELLY), "cells": CELLS},
            springs={"structural": FAMILY},
            wind=AIR,
            pins=[{"particles": [0], "moves": MOVES}],
        ),
        few=(
            (
                {
                    "tetrahedra": {"points": Point(JELLY[:4]), "cells": CELLS[:1]},
                    "pins": [],
                },
                4,
            ),
        ),
        wild={"springs": WILD},
        initial=JELLY,
        orders=ORDERS,
        more=SOLVERS,
        smooth=SMOOTH,
    ),
}
