"""How surfaces keep apart from themselves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from animtool._types import ArrayLike
from animtool.errors import Fault, OptionError
from animtool.sim.springs.body import Body

__all__ = ["SelfContact", "check_self_contact"]


@dataclass(frozen=True, slots=True)
class SelfContact:
    """How a surface keeps apart from itself: cloth in folds, rolls and layers.

    At the end of each step, each particle is as far from each triangle as the cloth is
    thick, on the side that it was, and Coulomb's friction takes from the way of one
    along the other. What one gains in momentum the other loses. Pairs that are
    nearer at rest keep that distance; neighbours, nearer along the surface than one and
    a half thicknesses, are left to the springs, and so are folds sharper than that.

    Limits of the method: what has gone through in spite of all, as where colliders
    close in on it, is remembered and brought back, but cloth that begins in a tangle
    stays in it. Edges may cut into each other, by less than they are long, where no
    particle goes through a triangle. A particle that in one step goes further than four
    thicknesses from the others may go through unseen: with colliders or pins that
    fast, take a shorter step.

    Attributes:
        thickness: Least distance [m].
        friction: Coulomb's coefficient [1].
        speed: With which what is nearer at the start comes apart [m/s]; it keeps none
            of it.
        rest: Where particles are at rest ``(N, 3)`` [m]; None is where the body begins.

    References:
        M. Müller, B. Heidelberger, M. Hennix, J. Ratcliff, Position Based Dynamics,
        2007, sections 3.5 and 4.4. R. Bridson, R. Fedkiw, J. Anderson, Robust Treatment
        of Collisions, Contact and Friction for Cloth Animation, 2002, section 7.
    """

    thickness: float
    friction: float = 0.2
    speed: float = 0.2
    rest: ArrayLike | None = None


def check_self_contact(contact: SelfContact, body: Body) -> None:
    """Raise where a body cannot keep apart from itself in this way.

    Raises:
        OptionError: A number is out of its range, positions at rest do not fit, or the
            body has no triangles (SIM045), with every such fault.
    """
    messages = []
    ranges = {"thickness": False, "friction": True, "speed": False}
    for name, itself in ranges.items():
        value = getattr(contact, name)
        if math.isfinite(value) and (value > 0 or (itself and value == 0)):
            continue
        bound = "0 or more" if itself else "above 0"
        messages.append(f"{name} must be finite and {bound}, not {value:g}")
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
