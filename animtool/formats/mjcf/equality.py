"""Joint equality constraints: linear ones are mimics, others drivers."""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np

from animtool.core.errors import circle, excerpt
from animtool.core.record import dataclass
from animtool.formats.robots.notes import XmlNotes
from animtool.rig.drivers import ANGLE, SLIDE, Driver
from animtool.rig.expressions import parse_expression
from animtool.rig.skeleton import Mimic

_EQ_JOINT = 2
_SLIDE = 2


@dataclass(slots=True, eq=False)
class JointEqualities:
    """Leader joint and polynomial of each constrained joint, by joint index."""

    mimics: dict[int, Mimic] = field(default_factory=dict)
    drivers: dict[int, Driver] = field(default_factory=dict)

    @staticmethod
    def of(model: Any, notes: XmlNotes) -> JointEqualities:
        """Return the active equalities of a model; record unsupported ones."""
        rows: dict[int, tuple[int, list[float]]] = {}
        for tie in range(model.neq):
            if model.eq_type[tie] != _EQ_JOINT:
                continue
            if not model.eq_active0[tie]:
                notes.leave_out(["equality that is not active"])
                continue
            one, other = int(model.eq_obj1id[tie]), int(model.eq_obj2id[tie])
            name = model.joint(one).name
            if one in rows:
                message = f"joint {excerpt(name)} is tied to two others by equality"
                hint = "keep the one that moves it"
                notes.add("MJC010", None, message, hint, joint=name)
                continue
            rows[one] = (other, np.array(model.eq_data[tie][:5]).tolist())
        ties = JointEqualities()
        if not _rings(model, rows, notes):
            for one in rows:
                ties._add(model, one, rows)
        return ties

    def _add(
        self, model: Any, one: int, rows: dict[int, tuple[int, list[float]]]
    ) -> None:
        """Add a follower; a linear leader is replaced by its own leader."""
        other, polynomial = rows[one]
        offset, gain = _linear(model, one, other, polynomial)
        curved = other >= 0 and any(polynomial[2:])
        while not curved and other in rows:
            further, inner = rows[other]
            if further < 0 or any(inner[2:]):
                break
            linear, factor = _linear(model, other, further, inner)
            offset, gain, other = offset + gain * linear, gain * factor, further
        if other < 0:
            text = repr(offset)
            self.drivers[one] = Driver(parse_expression(text, coordinates=True))
        elif curved:
            self.drivers[one] = _driver(model, one, other, polynomial)
        elif other in rows:
            # Linear in a joint that has a driver: a driver of a driver.
            polynomial = [polynomial[0], polynomial[1], 0.0, 0.0, 0.0]
            self.drivers[one] = _driver(model, one, rows[one][0], polynomial)
        else:
            self.mimics[one] = Mimic(model.joint(other).name, gain, offset)


def _ref(model: Any, joint: int) -> float:
    return float(model.qpos0[model.jnt_qposadr[joint]])


def _linear(
    model: Any, one: int, other: int, polynomial: list[float]
) -> tuple[float, float]:
    """Return offset and gain of the linear part; MuJoCo counts from ``ref``."""
    offset = _ref(model, one) + polynomial[0]
    if other < 0:
        return offset, 0.0
    return offset - polynomial[1] * _ref(model, other), polynomial[1]


def _driver(model: Any, one: int, other: int, polynomial: list[float]) -> Driver:
    """Return a polynomial as a driver, by Horner's scheme."""
    part = SLIDE if model.jnt_type[other] == _SLIDE else ANGLE
    read = repr(f"{model.joint(other).name}.{part}")
    x = f"({read} - {_ref(model, other)!r})"
    terms = polynomial
    while terms[-1] == 0.0 and len(terms) > 1:
        terms = terms[:-1]
    text = repr(terms[-1])
    for coefficient in reversed(terms[:-1]):
        text = f"({coefficient!r} + {x} * {text})"
    text = f"{_ref(model, one)!r} + {text}"
    return Driver(parse_expression(text, coordinates=True))


def _rings(
    model: Any, rows: dict[int, tuple[int, list[float]]], notes: XmlNotes
) -> bool:
    """Record cycles of constrained joints; return whether there are any."""
    done: set[int] = set()
    has_rings = False
    for start in rows:
        path: list[int] = []
        one = start
        while one in rows and one not in done:
            if one in path:
                names = [model.joint(j).name for j in path[path.index(one) :]]
                message = f"joints are tied in a ring: {circle([*names, names[0]])}"
                hint = "remove one of these equalities"
                notes.add("MJC010", None, message, hint, joint=names[0])
                has_rings = True
                break
            path.append(one)
            one = rows[one][0]
        done.update(path)
    return has_rings
