"""UsdPhysics stages as other tools and hands write them, simulated for some frames."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from animtool import BakeOptions, bake
from animtool.core.errors import AnimtoolError, Fault
from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems
from animtool.usd.layers.sdf import forget_layers, limit_usd_threads

ABOUT = "UsdPhysics stages of rigid bodies, with odd values, simulated"

FPS, FRAMES = 24, 3
# Share of cases whose result is written too.
BAKE_TEMPLATE = 0.05
# A stage is odd as a whole: none of its values is, some are, or many.
_ODD = (0.0, 0.003, 0.01, 0.03, 0.1, 0.4)
_NUMBERS = (
    *("nan", "inf", "-inf", "1e38", "-1e38", "1e39", "1e308", "1e13", "1e12", "1e9"),
    *("-1", "0", "-0.0", "1e-3", "1e-9", "1e-30", "1e-45", "1e-320", "-1e-9", "7.25"),
    *("3.4e38", "1e6", "-1e6", "1e19", "360", "-360", "180", "1e5"),
)
_WHOLE = ("-1", "0", "1", "2", "99", "2147483647", "-2147483648", "4", "5")
_TYPES = ("float", "double", "int", "string", "token", "float3", "int[]", "bool")
_SHAPES = ("Cube", "Sphere", "Capsule", "Mesh", "Xform")
_OTHERS = (
    *("Cylinder", "Cone", "Plane", "Points", "BasisCurves", "Scope", "Xyz", ""),
    *("Capsule_1", "Cylinder_1", "NurbsPatch", "PointInstancer", "TetMesh", "Camera"),
)
_JOINTS = ("Fixed", "Revolute", "Prismatic", "Spherical", "", "Distance")
_RIGID, _COLLIDES, _MASS = "RigidBodyAPI", "CollisionAPI", "MassAPI"
_TETRAHEDRON = (
    ["3"] * 4,
    ["0", "2", "1", "0", "1", "3", "1", "2", "3", "2", "0", "3"],
    [("0", "0", "0"), ("0.3", "0", "0"), ("0", "0.3", "0"), ("0", "0", "0.3")],
)


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    limit_usd_threads()
    stage, path = folder / "yard.usda", folder / "shot.scene.yaml"

    def run(rng: np.random.Generator) -> str:
        text = _Stage(rng).text()
        stage.write_text(text, "utf-8")
        entry: dict[str, Any] = {"file": "yard.usda", "prim": "/W"}
        if rng.random() < 0.1:
            entry["prim"] = str(rng.choice(["/", "/W/b0", "/W/floor", "/no"]))
        if rng.random() < 0.1:
            entry["frame"] = float(rng.choice([-1e6, 0.0, 5.5, 1e6]))
        written: dict[str, Any] = {}
        if rng.random() < 0.5:
            written = {"prims": "xforms", "physics": bool(rng.integers(2))}
        baked = rng.random() < BAKE_TEMPLATE
        scene = {
            "scene": "animtool/1",
            "fps": FPS,
            "range": [1, FRAMES],
            "systems": [{"rigid": {"name": "y", "stages": [entry], **written}}],
            "output": {"file": "shot.usda"},
        }
        path.write_text(json.dumps(scene), "utf-8")
        try:
            return _baked(path) if baked else _simulated(path)
        except AnimtoolError as error:
            _check(error.faults)
            return error.code
        finally:
            forget_layers()

    return run


def _check(faults: Any) -> None:
    """Refuse faults that say nothing."""
    for fault in faults:
        assert isinstance(fault, Fault)
        assert fault.code
        assert str(fault)


def _simulated(path: Path) -> str:
    (system,) = open_systems(load_scene(path).systems, (FRAMES - 1) / FPS)
    for frame in range(FRAMES):
        row = system.at(frame / FPS)
        for name in ("points", "velocities", "rotations", "spins"):
            assert np.isfinite(getattr(row, name)).all(), f"{name} are not finite"
    notices = sorted({notice.code for notice in system.notices})
    json.dumps(system.report(), allow_nan=False)
    return " ".join(["simulated", *notices])


def _baked(path: Path) -> str:
    output = path.with_name("shot.usda")
    bake(path, output, BakeOptions(overwrite=True))
    # Limits that joints do not have are infinite.
    assert not re.search(r"[\s(,\[-]nan\b", output.read_text("utf-8")), "not finite"
    return "baked"


class _Stage:
    """A stage as text, made of random numbers."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._share = float(rng.choice(_ODD))
        self._names = [f"b{i}" for i in range(int(rng.integers(1, 5)))]

    def text(self) -> str:
        rng = self._rng
        head = [
            f"metersPerUnit = {self._rarely('1', '0.01', '1')}",
            f"kilogramsPerUnit = {self._rarely('1', '0.001')}",
            f'upAxis = "{rng.choice(["Y", "Z"])}"',
            f"startTimeCode = {self._rarely('1', '0')}",
            f"timeCodesPerSecond = {self._rarely('24', '30')}",
        ]
        parts = [self._scene(), *map(self._body, self._names)]
        parts += [self._joint(i) for i in range(int(rng.integers(0, 4)))]
        parts.append(self._still())
        parts += self._rest()
        body = "\n".join(parts)
        lines = "\n    ".join(line for line in head if not self._odd() or rng.random())
        return (
            f"#usda 1.0\n(\n    {lines}\n)\n{self._model()}"
            f'def Xform "W" {{\n{self._places()}\n{body}\n}}\n'
        )

    # Values.

    def _odd(self) -> bool:
        return bool(self._rng.random() < self._share)

    def _number(self, *good: str) -> str:
        return str(self._rng.choice(_NUMBERS if self._odd() else good))

    def _rarely(self, *good: str) -> str:
        """Return a number that is odd less often: all of a stage hangs on it."""
        return self._number(*good) if self._rng.random() < 0.15 else good[0]

    def _few(self, *good: str) -> str:
        """Return a number that is odd half as often: without a place all ends."""
        return (
            str(self._rng.choice(good))
            if self._rng.integers(2)
            else self._number(*good)
        )

    def _size(self) -> str:
        return self._number("0.1", "0.5", "1", "0.25")

    def _vector(self, *good: str) -> str:
        return f"({', '.join(self._number(*good) for _ in range(3))})"

    def _turn(self) -> str:
        if self._rng.random() < 0.7 and not self._odd():
            return "(1, 0, 0, 0)"
        return f"({', '.join(self._number('1', '0', '0.5') for _ in range(4))})"

    def _attribute(self, kind: str, name: str, value: str) -> str:
        """Return an attribute; an odd one may have another type, or no value."""
        if self._rng.random() < self._share / 4:
            other = str(self._rng.choice(_TYPES))
            return f"custom {other} {name}"
        if self._rng.random() < self._share / 8:
            return f"{kind} {name} = None"
        return f"{kind} {name} = {value}"

    def _some(self, share: float, kind: str, name: str, value: str) -> Iterator[str]:
        if self._rng.random() < share:
            yield self._attribute(kind, name, value)

    # What places prims.

    def _places(self) -> str:
        rng, lines, order = self._rng, list[str](), list[str]()
        if rng.random() < 0.6:
            good = ("0", "1", "2", "-1", "0.3")
            value = f"({', '.join(self._few(*good) for _ in range(3))})"
            if rng.random() < 0.15:
                codes = [self._number("1"), self._number("12"), self._number("30")]
                codes = [c for c in codes if c not in ("nan", "inf", "-inf")]
                rows = ", ".join(
                    f"{code}: {self._vector('0', '1', '2')}" for code in codes
                )
                lines.append(f"double3 xformOp:translate.timeSamples = {{{rows}}}")
            else:
                lines.append(f"double3 xformOp:translate = {value}")
            order.append("xformOp:translate")
        if rng.random() < 0.2:
            lines.append(f"quatf xformOp:orient = {self._turn()}")
            order.append("xformOp:orient")
        if rng.random() < 0.2:
            value = self._vector("1", "2", "0.5", "-1")
            if rng.random() < 0.5:
                size = self._number("1", "2", "-1")
                value = f"({size}, {size}, {size})"
            lines.append(f"float3 xformOp:scale = {value}")
            order.append("xformOp:scale")
        if rng.random() < 0.05 + self._share / 4:
            rows = [[self._rarely("0") for _ in range(4)] for _ in range(4)]
            for i in range(4):
                rows[i][i] = self._rarely("1")
            matrix = ", ".join(f"({', '.join(row)})" for row in rows)
            lines.append(f"matrix4d xformOp:transform = ({matrix})")
            order.append("xformOp:transform")
        if rng.random() < self._share / 40:
            order.insert(0, str(rng.choice(["!resetXformStack!", "xformOp:none", "x"])))
        names = ", ".join(f'"{name}"' for name in order)
        lines.append(f"uniform token[] xformOpOrder = [{names}]")
        return "\n".join(lines)

    # Prims.

    def _scene(self) -> str:
        if self._rng.random() < 0.1:
            return ""
        way = self._vector("0", "-1", "0")
        return _prim(
            "PhysicsScene",
            "scene",
            [
                self._attribute("vector3f", "physics:gravityDirection", way),
                self._attribute(
                    "float", "physics:gravityMagnitude", self._number("9.81", "-inf")
                ),
            ],
        )

    def _body(self, name: str) -> str:
        rng = self._rng
        apis = [_RIGID] if rng.random() < 0.95 else []
        kind, lines = self._shape(apis)
        f, a = self._attribute, self._vector
        lines += self._some(0.2, "vector3f", "physics:velocity", a("0", "1", "-3"))
        lines += self._some(
            0.2, "vector3f", "physics:angularVelocity", a("0", "90", "-400")
        )
        lines += self._some(0.2, "bool", "physics:kinematicEnabled", "1")
        lines += self._some(0.05, "bool", "physics:rigidBodyEnabled", "0")
        if rng.random() < 0.3:
            apis.append(_MASS)
            lines += self._some(0.6, "float", "physics:mass", self._number("1", "0"))
            lines += self._some(0.4, "float", "physics:density", self._number("500"))
            lines += self._some(0.3, "point3f", "physics:centerOfMass", a("0", "0.05"))
            lines += self._some(
                0.3, "float3", "physics:diagonalInertia", a("0.1", "0.12")
            )
            lines.append(f("quatf", "physics:principalAxes", self._turn()))
        if rng.random() < 0.3:
            apis.append("MaterialBindingAPI")
            target = rng.choice(["/W/stuff", "/W/no", "/W/b0"])
            lines.append(f"rel material:binding:physics = <{target}>")
        if rng.random() < 0.05:
            apis.append(str(rng.choice(["ArticulationRootAPI", "FilteredPairsAPI"])))
            lines.append("rel physics:filteredPairs = </W/b0>")
        inner = [self._part(i) for i in range(int(rng.integers(0, 3)))]
        if kind == "Xform" or rng.random() < 0.2:
            lines += inner
        if rng.random() < 0.08:
            lines.append(self._nested())
        own = "instanceable = true\nprepend references = </Model>"
        more = own if rng.random() < 0.06 else ""
        return _prim(kind, name, lines, apis, more)

    def _nested(self) -> str:
        apis = [_RIGID]
        kind, lines = self._shape(apis)
        return _prim(kind, "inside", lines, apis)

    def _part(self, number: int) -> str:
        apis: list[str] = []
        kind, lines = self._shape(apis)
        return _prim(kind, f"part{number}", lines, apis)

    def _shape(self, apis: list[str]) -> tuple[str, list[str]]:
        """Return type and lines of a shape; what it collides by is added."""
        rng = self._rng
        kinds = _OTHERS if rng.random() < 0.05 + self._share / 3 else _SHAPES
        kind = str(rng.choice(kinds))
        lines = [self._places()]
        if rng.random() < 0.9:
            apis.append(_COLLIDES)
            lines += self._some(0.05, "bool", "physics:collisionEnabled", "0")
        f = self._attribute
        if kind in ("Cube", "Cylinder", "Xyz"):
            lines += self._some(0.8, "double", "size", self._size())
        if kind in ("Sphere", "Capsule", "Cylinder", "Cone", "Xyz"):
            lines += self._some(0.8, "double", "radius", self._size())
        if kind in ("Capsule", "Cylinder", "Cone"):
            lines += self._some(0.8, "double", "height", self._size())
        if kind in ("Capsule", "Cylinder", "Cone", "Plane"):
            axes = ["W", "", "x"] if self._odd() else ["X", "Y", "Z"]
            lines += self._some(0.6, "uniform token", "axis", f'"{rng.choice(axes)}"')
        if kind in ("Mesh", "Points", "Xyz"):
            lines += self._mesh(apis)
        if rng.random() < 0.02:
            lines.append(f("float3[]", "extent", "[(0, 0, 0), (inf, 1, nan)]"))
        return kind, lines

    def _mesh(self, apis: list[str]) -> list[str]:
        rng = self._rng
        counts, corners, points = (list(part) for part in _TETRAHEDRON)
        for _ in range(int(rng.integers(1, 3)) if self._odd() else 0):
            values = (counts, corners)[int(rng.integers(2))]
            kind = rng.integers(4)
            if kind == 0:
                del values[int(rng.integers(len(values) + 1)) :]
            elif kind == 1:
                values *= 2
            elif values:
                values[int(rng.integers(len(values)))] = str(rng.choice(_WHOLE))
        if self._odd():
            kind = rng.integers(3)
            points = [[], points[:2], points * 2][kind]
        rows = ", ".join(
            f"({', '.join(self._number(v) if self._odd() else v for v in point)})"
            for point in points
        )
        apis.append("MeshCollisionAPI")
        f = self._attribute
        return [
            f("int[]", "faceVertexCounts", f"[{', '.join(counts)}]"),
            f("int[]", "faceVertexIndices", f"[{', '.join(corners)}]"),
            f("point3f[]", "points", f"[{rows}]"),
            'uniform token physics:approximation = "convexHull"',
        ]

    def _joint(self, number: int) -> str:
        rng = self._rng
        kind, lines, apis = str(rng.choice(_JOINTS)), list[str](), list[str]()
        for side in (0, 1):
            if rng.random() < 0.1:
                continue
            targets = [f"/W/{name}" for name in self._names]
            if self._odd():
                targets = ["/W/no", "/W", "/W/scene", "/W/b0.x", "/W/floor", "/No"]
                targets += ["/W/b0/part0", "/W/b1/inside", "/W/b0/shape"]
            lines.append(f"rel physics:body{side} = <{rng.choice(targets)}>")
            place = self._vector("0", "0.1", "-0.2")
            lines += self._some(0.5, "point3f", f"physics:localPos{side}", place)
            lines += self._some(0.5, "quatf", f"physics:localRot{side}", self._turn())
        lines += self._some(0.3, "uniform token", "physics:axis", '"Z"')
        low, high = self._number("-30", "-0.1"), self._number("40", "0.2", "-90")
        lines += self._some(0.5, "float", "physics:lowerLimit", low)
        lines += self._some(0.5, "float", "physics:upperLimit", high)
        for i in (0, 1):
            cone = self._number("30", "40", "-1", "179", "180")
            lines += self._some(0.5, "float", f"physics:coneAngle{i}Limit", cone)
        for name in ("breakForce", "breakTorque"):
            force = self._number("inf", "100")
            lines += self._some(0.1, "float", f"physics:{name}", force)
        axes = ("rotX", "rotY", "rotZ", "angular", "linear", "transX")
        for axis in axes if rng.random() < 0.3 else ():
            if rng.random() < 0.7:
                apis.append(f"LimitAPI:{axis}")
                for end, value in (("low", "-30"), ("high", "30")):
                    limit = self._number(value)
                    lines.append(f"float limit:{axis}:physics:{end} = {limit}")
        for axis in axes if rng.random() < 0.3 else ():
            apis.append(f"DriveAPI:{axis}")
            for name in ("stiffness", "damping", "targetPosition", "maxForce"):
                value = self._number("0", "1", "10")
                lines += self._some(0.6, "float", f"drive:{axis}:physics:{name}", value)
        return _prim(f"Physics{kind}Joint", f"j{number}", lines, apis)

    def _still(self) -> str:
        apis: list[str] = []
        if self._rng.random() < 0.6:
            axis = self._rng.choice(["X", "Y", "Z"])
            lines = [f'uniform token axis = "{axis}"', self._places()]
            return _prim("Plane", "floor", lines, [_COLLIDES])
        kind, lines = self._shape(apis)
        return _prim(kind, "floor", lines, apis)

    def _rest(self) -> Iterator[str]:
        f = self._attribute
        yield _prim(
            "Material",
            "stuff",
            [
                f("float", "physics:dynamicFriction", self._number("0.5", "0")),
                f("float", "physics:staticFriction", self._number("0.5", "0")),
                f("float", "physics:restitution", self._number("0.2", "1")),
                f("float", "physics:density", self._number("100", "0")),
            ],
            ["MaterialAPI"],
        )
        if self._rng.random() < 0.1:
            lines = ["rel collection:colliders:includes = </W/b0>"]
            lines.append("rel physics:filteredGroups = </W/group>")
            yield _prim("PhysicsCollisionGroup", "group", lines)

    def _model(self) -> str:
        apis: list[str] = []
        kind, lines = self._shape(apis)
        inside = _prim(kind, "shape", lines, apis)
        apis = [_RIGID] if self._rng.random() < 0.4 else []
        return f"class {_prim('Xform', 'Model', [inside], apis).removeprefix('def ')}\n"


def _prim(
    kind: str,
    name: str,
    lines: list[str],
    apis: list[str] | None = None,
    more: str = "",
) -> str:
    """Return a prim as text."""
    schemas = [
        api if api.startswith("Material") and "Bind" in api else f"Physics{api}"
        for api in apis or ()
    ]
    named = ", ".join(f'"{schema}"' for schema in schemas)
    data = f"prepend apiSchemas = [{named}]\n{more}" if named else more
    body = "\n".join(filter(None, lines))
    return f'def {kind} "{name}" (\n{data}\n) {{\n{body}\n}}'
