"""Step doubling: one step beside two half steps, until they agree."""

from __future__ import annotations

from dataclasses import replace

from numpy.polynomial import polynomial as poly

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import Control, Integrator, Step
from animtool.sim.integrators.rk4 import INTEGRATOR as RK4
from animtool.sim.stability import rate_limit


def doubled(base: Integrator) -> Integrator:
    """Return step doubling with steps of another method.

    What the two half steps miss is taken from how far the whole one is off, and added:
    so the order is one more than that of the other method.

    Raises:
        OptionError: The other method's steps need those before, or are not fixed
            (SIM006).
    """
    step = base.step
    if step is None or base.control is not Control.FIXED or base.multistep:
        message = f"{base.name} cannot be the base of adaptive_doubling"
        hint = "take one with steps of its own, such as rk4 or implicit_euler"
        raise OptionError(Fault("SIM006", message, where="base", hint=hint))
    gain = 1 / (2**base.order - 1)
    growth = _growth(base.growth, gain)

    def both(
        equations: Equations,
        t: float,
        y: FloatArray,
        h: float,
        memory: object,
    ) -> Step | None:
        whole = step(equations, t, y, h, None)
        first = step(equations, t, y, h / 2, None)
        if whole is None or first is None:
            return None
        second = step(equations, t + h / 2, first.state, h / 2, first.memory)
        if second is None:
            return None
        error = gain * (second.state - whole.state)
        return Step(second.state + error, error=error)

    return replace(
        base,
        name="adaptive_doubling",
        summary="one step beside two half steps, until they agree",
        order=base.order + 1,
        control=Control.ADAPTIVE,
        step=both,
        limit=rate_limit(growth) if growth else None,
        growth=growth,
        drag_order=None,
        evaluations=base.evaluations and 3 * base.evaluations,
        error_order=base.order + 1,
        symplectic=False,
        reversible=False,
    )


def _growth(base: tuple[float, ...], gain: float) -> tuple[float, ...]:
    """Return by what two half steps with their correction grow; empty where unknown."""
    if not base:
        return ()
    half = [c / 2**i for i, c in enumerate(base)]
    twice = poly.polymul(half, half)
    found = poly.polyadd(twice * (1 + gain), poly.polymul(base, [-gain]))
    return tuple(found.tolist())


INTEGRATOR = doubled(RK4)
