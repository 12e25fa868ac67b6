"""Problems of ``$ANIMTOOL_DATA/sim`` as systems with reference answers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.sim import Energy, FirstOrder, ForceSystem, RateSystem, SecondOrder


@dataclass(frozen=True)
class Problem:
    """An instance of a file.

    Attributes:
        name: Of the file and the instance.
        system: What moves.
        times: [s]
        states: At these times ``(F, …)``; of particles positions only ``(F, N, d)``.
        accuracy: Of the states.
        fastest: Angular frequency [rad/s] and damping ratio of its fastest motion;
            None of what has no single one.
        kept: Name of what stays the same, and how to tell it from a state.
    """

    name: str
    system: FirstOrder | SecondOrder
    times: FloatArray
    states: FloatArray
    accuracy: float
    fastest: tuple[float, float] | None = None
    kept: tuple[str, Callable[[FloatArray], float]] | None = None

    @property
    def size(self) -> float:
        """The largest value of the reference."""
        return float(np.abs(self.states).max())


def read_problems(path: Path) -> list[Problem]:
    """Return the problems of a file, none where it holds no motion of one system."""
    data = json.loads(path.read_text("utf-8"))
    make = _MAKERS.get(data.get("case"))
    return list(make(data)) if make else []


def _columns(values: dict[str, Any], *names: str) -> FloatArray:
    return np.stack([np.asarray(values[name], np.float64) for name in names], axis=-1)


def _damped_spring(data: dict[str, Any]) -> Iterator[Problem]:
    for entry in data["instances"]:
        m, k, c, rest = (entry["params"][key] for key in ("m", "k", "c", "rest_length"))
        omega, zeta = entry["omega0"], entry["zeta"]
        system = ForceSystem(
            lambda _t, x, v, m=m, k=k, c=c, rest=rest: (-k * (x - rest) - c * v) / m,
            [[entry["initial"]["x"]]],
            [[entry["initial"]["v"]]],
            jacobians=lambda *_, m=m, k=k, c=c: (
                np.array([[-k / m]]),
                np.array([[-c / m]]),
            ),
            energy=lambda _t, y, m=m, k=k, rest=rest: Energy(
                0.5 * m * float(y[1, 0, 0] ** 2),
                0.5 * k * float((y[0, 0, 0] - rest) ** 2),
            ),
            frequencies=[(omega, zeta)],
        )
        states = np.asarray(entry["reference"]["x"])[:, None, None]
        yield Problem(
            f"damped_spring {entry['id']}", system, np.asarray(entry["t"]), states,
            entry["reference_accuracy"], (omega, zeta),
        )  # fmt: skip


def _pendulum(data: dict[str, Any]) -> Iterator[Problem]:
    for entry in data["instances"]:
        pull = entry["params"]["g"] / entry["params"]["length"]
        system = ForceSystem(
            lambda _t, x, _v, pull=pull: -pull * np.sin(x),
            [[entry["initial"]["theta"]]],
            [[entry["initial"]["omega"]]],
            jacobians=lambda _t, x, _v, pull=pull: (
                -pull * np.cos(x),
                np.zeros((1, 1)),
            ),
            energy=lambda _t, y, pull=pull: Energy(
                0.5 * float(y[1, 0, 0] ** 2), -pull * float(np.cos(y[0, 0, 0]))
            ),
            frequencies=[(pull**0.5, 0.0)],
            velocity_dependent=False,
        )
        states = np.asarray(entry["reference"]["theta"])[:, None, None]
        yield Problem(
            f"pendulum {entry['id']}", system, np.asarray(entry["t"]), states,
            entry["reference_accuracy"], (pull**0.5, 0.0),
        )  # fmt: skip
    for entry in data.get("elastic_instances", []):
        yield _elastic(entry)


def _elastic(entry: dict[str, Any]) -> Problem:
    g, rest, m, k = (entry["params"][key] for key in ("g", "length", "m", "k"))
    start, down = entry["initial"], np.array([0.0, -g])

    def acceleration(_t: float, x: FloatArray, _v: FloatArray) -> FloatArray:
        length = np.linalg.norm(x, axis=1, keepdims=True)
        return down - (k / m) * (1 - rest / length) * x

    def energy(_t: float, y: FloatArray) -> Energy:
        over = float(np.linalg.norm(y[0])) - rest
        lift = m * g * float(y[0, 0, 1])
        return Energy(0.5 * m * float((y[1] ** 2).sum()), 0.5 * k * over**2 + lift)

    def jacobians(
        _t: float, x: FloatArray, _v: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        length = float(np.linalg.norm(x))
        along = np.outer(x[0], x[0]) * rest / length**3
        pull = (1 - rest / length) * np.eye(2) + along
        return -(k / m) * pull, np.zeros((2, 2))

    omega = (k / m) ** 0.5
    system = ForceSystem(
        acceleration,
        [[start["x"], start["y"]]],
        [[start["vx"], start["vy"]]],
        jacobians=jacobians,
        energy=energy,
        frequencies=[(omega, 0.0)],
        velocity_dependent=False,
    )
    states = _columns(entry["reference"], "x", "y")[:, None]
    return Problem(
        f"pendulum elastic {entry['id']}", system, np.asarray(entry["t"]), states,
        entry["reference_accuracy"], (omega, 0.0),
    )  # fmt: skip


def kepler_system(mu: float, position: list[float], velocity: list[float]) -> Any:
    """Return a body about a mass at the origin."""

    def acceleration(_t: float, x: FloatArray, _v: FloatArray) -> FloatArray:
        ((a, b),) = x.tolist()
        square = a * a + b * b
        pull = -mu / (square * square**0.5) if square else np.nan
        return np.array([[pull * a, pull * b]])

    def energy(_t: float, y: FloatArray) -> Energy:
        speed = float((y[1] ** 2).sum())
        return Energy(0.5 * speed, -mu / float(np.linalg.norm(y[0])))

    def jacobians(
        _t: float, x: FloatArray, _v: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        r = float(np.linalg.norm(x))
        pull = mu * (3 * np.outer(x[0], x[0]) / r**5 - np.eye(2) / r**3)
        return pull, np.zeros((2, 2))

    return ForceSystem(
        acceleration,
        [position],
        [velocity],
        jacobians=jacobians,
        energy=energy,
        velocity_dependent=False,
    )


def _kepler(data: dict[str, Any]) -> Iterator[Problem]:
    for entry in data["instances"]:
        start = entry["initial"]
        system = kepler_system(
            entry["params"]["mu"],
            [start["x"], start["y"]],
            [start["vx"], start["vy"]],
        )
        states = _columns(entry["reference"], "x", "y")[:, None]

        def momentum(y: FloatArray) -> float:
            (a, b), (va, vb) = y[0, 0], y[1, 0]
            return float(a * vb - b * va)

        mean = 2 * np.pi / entry["period"]
        near = (1 - entry["params"]["e"]) ** 1.5
        yield Problem(
            f"kepler {entry['id']}", system, np.asarray(entry["t"]), states,
            entry["reference_accuracy"], (mean / near, 0.0),
            ("angular momentum", momentum),
        )  # fmt: skip


def _vortex(data: dict[str, Any]) -> Iterator[Problem]:
    for entry in data["instances"]:
        params, start = entry["params"], entry["initial"]
        rate, omega, kept = _FIELDS[entry["field"]](params)
        system = RateSystem(
            rate, [[start["x"], start["y"]]], frequencies=[(omega, 0.0)]
        )
        states = _columns(entry["reference"], "x", "y")[:, None]
        yield Problem(
            f"vortex_particle {entry['id']}", system, np.asarray(entry["t"]), states,
            entry["reference_accuracy"], (omega, 0.0),
            (entry["invariant"]["name"], kept),
        )  # fmt: skip


def _rigid_rotation(params: dict[str, float]) -> Any:
    omega = params["omega"]
    turn = np.array([[0.0, omega], [-omega, 0.0]])
    return lambda _t, y: y @ turn, omega, lambda y: float(np.linalg.norm(y))


def _taylor_green(params: dict[str, float]) -> Any:
    k, u = 2 * np.pi / params["length"], params["U"]

    def rate(_t: float, y: FloatArray) -> FloatArray:
        a, b = k * y[:, 0], k * y[:, 1]
        return u * np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)], 1)

    def stream(y: FloatArray) -> float:
        return float(np.sin(k * y[0, 0]) * np.sin(k * y[0, 1]))

    return rate, k * u, stream


_FIELDS = {"rigid_rotation": _rigid_rotation, "taylor_green": _taylor_green}


def _stiff(data: dict[str, Any]) -> Iterator[Problem]:
    for entry in data["instances"]:
        rate, slope = _STIFF[entry["system"]](entry["params"])
        system = RateSystem(rate, entry["initial"], jacobian=slope)
        kept = None
        if "invariant" in entry:
            kept = (entry["invariant"], lambda y: float(y.sum()))
        yield Problem(
            f"stiff_ode {entry['id']}", system, np.asarray(entry["t"], np.float64),
            np.asarray(entry["reference"]), entry["reference_accuracy"], kept=kept,
        )  # fmt: skip


def _van_der_pol(params: dict[str, float]) -> Any:
    mu = params["mu"]

    def rate(_t: float, y: FloatArray) -> FloatArray:
        x, v = y.tolist()
        return np.array([v, mu * (1 - x * x) * v - x])

    def slope(_t: float, y: FloatArray) -> FloatArray:
        x, v = y.tolist()
        return np.array([[0.0, 1.0], [-2 * mu * x * v - 1, mu * (1 - x * x)]])

    return rate, slope


def _robertson(params: dict[str, float]) -> Any:
    k1, k2, k3 = params["k1"], params["k2"], params["k3"]

    def rate(_t: float, y: FloatArray) -> FloatArray:
        a, b, c = y.tolist()
        gone, back, on = k1 * a, k3 * b * c, k2 * b * b
        return np.array([back - gone, gone - back - on, on])

    def slope(_t: float, y: FloatArray) -> FloatArray:
        _, b, c = y.tolist()
        first = [-k1, k3 * c, k3 * b]
        third = [0.0, 2 * k2 * b, 0.0]
        second = [-p - q for p, q in zip(first, third, strict=True)]
        return np.array([first, second, third])

    return rate, slope


_STIFF = {"van_der_pol": _van_der_pol, "robertson": _robertson}
_MAKERS: dict[str, Callable[[dict[str, Any]], Iterator[Problem]]] = {
    "damped_spring": _damped_spring,
    "pendulum": _pendulum,
    "kepler": _kepler,
    "vortex_particle": _vortex,
    "stiff_ode": _stiff,
}
