"""Motions with answers in closed form, as systems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim import Energy, ForceSystem, RateSystem
from animtool.sim.equations import Equations
from animtool.sim.integrators.integrator import EquationForm, Integrator


@dataclass(frozen=True)
class Motion:
    """A system and its state at any time."""

    system: ForceSystem | RateSystem
    state: Callable[[float], FloatArray]


def oscillator(
    omega: float = 1.0, damping: float = 0.0, *, start: tuple[float, float] = (1.0, 0.5)
) -> Motion:
    """Return x'' + 2 ζ ω x' + ω² x = 0, ζ other than 1."""
    system = ForceSystem(
        lambda _t, x, v: -(omega**2) * x - (2 * damping * omega) * v,
        [[start[0]]],
        [[start[1]]],
        jacobians=lambda *_: (
            np.array([[-(omega**2)]]),
            np.array([[-2 * damping * omega]]),
        ),
        energy=lambda _t, y: Energy(
            0.5 * float(y[1, 0, 0] ** 2), 0.5 * float((omega * y[0, 0, 0]) ** 2)
        ),
        frequencies=[(omega, damping)],
        velocity_dependent=damping > 0,
    )
    slope = np.array([[0.0, 1.0], [-(omega**2), -2 * damping * omega]])
    values, vectors = np.linalg.eig(slope.astype(complex))
    weights = np.linalg.solve(vectors, np.array(start, complex))

    def state(t: float) -> FloatArray:
        found: FloatArray = (vectors @ (weights * np.exp(values * t))).real
        return found.reshape(2, 1, 1)

    return Motion(system, state)


def pendulum(swing: float = 2.0) -> Motion:
    """Return θ'' = -sin θ from rest at an angle, by Jacobi's elliptic functions."""
    from scipy.special import ellipj, ellipk

    system = ForceSystem(
        lambda _t, x, _v: -np.sin(x),
        [[swing]],
        jacobians=lambda _t, x, _v: (-np.cos(x), np.zeros((1, 1))),
        energy=lambda _t, y: Energy(
            0.5 * float(y[1, 0, 0] ** 2), -float(np.cos(y[0, 0, 0]))
        ),
        velocity_dependent=False,
    )
    k = np.sin(swing / 2)

    def state(t: float) -> FloatArray:
        sn, cn, _, _ = ellipj(t + ellipk(k * k), k * k)
        return np.array([[[2 * np.arcsin(k * sn)]], [[2 * k * cn]]])

    return Motion(system, state)


def pendulum_period(swing: float) -> float:
    """Return the period of `pendulum` [s]."""
    from scipy.special import ellipk

    return float(4 * ellipk(np.sin(swing / 2) ** 2))


def logistic() -> Motion:
    """Return y' = cos(t) y (1 - y), whose rate depends on time and state."""

    def state(t: float) -> FloatArray:
        grown = 0.25 * np.exp(np.sin(t))
        return np.array([grown / (1 + grown)])

    system = RateSystem(lambda t, y: np.cos(t) * y * (1 - y), [0.2])
    return Motion(system, state)


def turning(rate: complex) -> RateSystem:
    """Return y' = λ y of a complex number, as two real ones."""
    slope = np.array([[rate.real, -rate.imag], [rate.imag, rate.real]])
    return RateSystem(lambda _t, y: slope @ y, [1.0, 0.0], jacobian=lambda *_: slope)


def stepped(
    integrator: Integrator,
    system: ForceSystem | RateSystem,
    end: float,
    count: int,
    start: float = 0.0,
) -> FloatArray:
    """Return where a number of even steps of a method lead."""
    assert integrator.step is not None
    equations, y, memory = Equations(system), system.state, None
    h = (end - start) / count
    for i in range(count):
        step = integrator.step(equations, start + i * h, y, h, memory)
        assert step is not None
        y, memory = step.state, step.memory
    return y


def step_matrix(integrator: Integrator, motion: Motion, h: float) -> FloatArray:
    """Return the matrix by which a step takes (x, v) of a linear motion further."""
    assert integrator.step is not None
    equations = Equations(motion.system)
    columns = []
    for unit in np.eye(2):
        step = integrator.step(equations, 0.0, unit.reshape(2, 1, 1), h, None)
        assert step is not None
        columns.append(step.state.ravel())
    return np.stack(columns, axis=1)


def serves(integrator: Integrator, motion: Motion) -> bool:
    """Return whether a method has steps for a motion."""
    apart = integrator.form is EquationForm.ACCELERATIONS
    fits = not apart or isinstance(motion.system, ForceSystem)
    return fits and integrator.step is not None


def kepler(eccentricity: float) -> Motion:
    """Return a body about a mass, semi-axis and μ 1, from where it is nearest."""
    near = 1 - eccentricity
    speed = ((1 + eccentricity) / near) ** 0.5

    def acceleration(_t: float, x: FloatArray, _v: FloatArray) -> FloatArray:
        ((a, b),) = x.tolist()
        pull = -1 / (a * a + b * b) ** 1.5
        return np.array([[pull * a, pull * b]])

    def jacobians(
        _t: float, x: FloatArray, _v: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        r = float(np.linalg.norm(x))
        slope = 3 * np.outer(x[0], x[0]) / r**5 - np.eye(2) / r**3
        return slope, np.zeros((2, 2))

    def state(t: float) -> FloatArray:
        anomaly = t
        for _ in range(50):
            off = anomaly - eccentricity * np.sin(anomaly) - t
            anomaly -= off / (1 - eccentricity * np.cos(anomaly))
        side = (1 - eccentricity**2) ** 0.5
        x = [np.cos(anomaly) - eccentricity, side * np.sin(anomaly)]
        rate = 1 / (1 - eccentricity * np.cos(anomaly))
        v = [-np.sin(anomaly) * rate, side * np.cos(anomaly) * rate]
        return np.array([[x], [v]])

    system = ForceSystem(
        acceleration,
        [[near, 0.0]],
        [[0.0, speed]],
        jacobians=jacobians,
        velocity_dependent=False,
    )
    return Motion(system, state)
