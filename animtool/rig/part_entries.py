"""Rig file parts: meshes, shapes, controls, chains, attachments, colliders."""

from __future__ import annotations

import keyword
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import field

from animtool.core.errors import cycle_text
from animtool.core.names import name_hint
from animtool.core.record import dataclass
from animtool.documents.document import Document, Location
from animtool.rig.array_entries import ArrayReader, AttachmentReader
from animtool.rig.controls import Control, Drive, evaluation_order
from animtool.rig.driver_entries import (
    check_no_interpolation,
    read_driver,
    record_descents,
)
from animtool.rig.drivers import Driver
from animtool.rig.expressions import FUNCTIONS, Expression, parse_expression
from animtool.rig.joint_entries import FileJoints, FileUnits, scale_vector, unit_vector
from animtool.rig.joint_schema import DrivenModel, MeshModel, SkinModel
from animtool.rig.joints import DRIVEN_PARTS, part_hint, split_part
from animtool.rig.parts import (
    Attachment,
    Capsule,
    Collider,
    DependencyCycleError,
    IkChain,
    Inbetween,
    Mesh,
    Shape,
    Skin,
    Subdivision,
)
from animtool.rig.schema import ControlModel, DriveModel, RigModel
from animtool.rig.shapes import combination_order
from animtool.rig.skeleton import Joint

_LIST_KEY_BY_KIND = {
    "joint": "joints",
    "mesh": "meshes",
    "shape": "shapes",
    "control": "controls",
}


@dataclass(slots=True)
class PartReader:
    """Builds the parts of a rig from its file; records faults in the document."""

    document: Document  # the file
    model: RigModel  # content of the file
    units: FileUnits  # units of its numbers
    file_joints: FileJoints  # the rig's joints
    array_reader: ArrayReader  # checks the arrays that the file refers to
    # Number of points of each mesh, if known.
    point_counts: dict[str, int] = field(default_factory=dict)
    joint_by_name: dict[str, Joint] = field(init=False)
    # Names of the rig's controls.
    control_names: dict[str, None] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        """Index the joints of the rig by name."""
        self.joint_by_name = {joint.name: joint for joint in self.file_joints.joints}

    def read_meshes(self) -> tuple[Mesh, ...]:
        """Return the meshes; check their arrays."""
        self._check_distinct("meshes", "mesh")
        return tuple(
            self._read_mesh(("meshes", i), mesh)
            for i, mesh in enumerate(self.model.meshes)
        )

    def read_shapes(
        self, meshes: Iterable[str], inherited_names: Iterable[str]
    ) -> tuple[Shape, ...]:
        """Return the blend shapes; check their arrays."""
        self._check_distinct("shapes", "shape")
        shape_names = dict.fromkeys(
            [*inherited_names, *(shape.name for shape in self.model.shapes)]
        )
        meshes = dict.fromkeys(meshes)
        shapes = []
        for i, shape in enumerate(self.model.shapes):
            location = ("shapes", i)
            if shape.mesh is not None:
                self._check_known((*location, "mesh"), shape.mesh, meshes, "mesh")
            row_count = self.point_counts.get(shape.mesh or "")
            vertex_indices = self.array_reader.read_optional_array(
                location, shape.vertices, "vertices", (None,), row_count
            )
            if vertex_indices is not None:
                row_count = self.array_reader.row_count(vertex_indices)
            delta_shape = (row_count, 3)
            for k, name in enumerate(shape.combine):
                self._check_known((*location, "combine", k), name, shape_names, "shape")
            inbetweens: list[Inbetween] = []
            weights = [entry.at for entry in shape.inbetweens]
            predecessors = dict(
                self.document.unordered_entries(
                    (*location, "inbetweens"), weights, "at"
                )
            )
            for k, inbetween in enumerate(shape.inbetweens):
                inbetween_location = (*location, "inbetweens", k)
                if inbetween.at in {0, 1} or k in predecessors:
                    message = f"inbetween weight {inbetween.at:g} is out of order"
                    hint = "weights ascend strictly between 0 (no deltas) and 1 "
                    hint += "(the main deltas)"
                    self.document.add(
                        "RIG024", (*inbetween_location, "at"), message, hint
                    )
                deltas = self.array_reader.read_array(
                    inbetween_location, inbetween.deltas, "deltas", delta_shape
                )
                normals = self.array_reader.read_optional_array(
                    inbetween_location, inbetween.normals, "normals", delta_shape
                )
                inbetweens.append(Inbetween(inbetween.at, deltas, normals))
            shapes.append(
                Shape(
                    shape.name,
                    shape.mesh or "",
                    self.array_reader.read_optional_array(
                        location, shape.deltas, "deltas", delta_shape
                    ),
                    self.array_reader.read_optional_array(
                        location, shape.normals, "normals", delta_shape
                    ),
                    tuple(inbetweens),
                    tuple(shape.combine),
                    vertex_indices,
                    self._read_driver((*location, "driven"), shape.driven),
                )
            )
        try:
            combination_order(shapes)
        except DependencyCycleError as error:
            index = [shape.name for shape in shapes].index(error.cycle[0])
            message = f"shapes combine each other in a cycle: {error}"
            self.document.add("RIG026", ("shapes", index, "combine"), message)
        return tuple(shapes)

    def read_controls(
        self, shapes: Iterable[str], inherited_controls: Sequence[Control]
    ) -> tuple[Control, ...]:
        """Return the controls; check their targets and dependencies."""
        self._check_distinct("controls", "control")
        entry_index_by_name = {
            control.name: i for i, control in enumerate(self.model.controls)
        }
        known_shapes = dict.fromkeys(shapes)
        inherited_controls = [
            control
            for control in inherited_controls
            if control.name not in entry_index_by_name
        ]
        self.control_names = dict.fromkeys(
            [*(control.name for control in inherited_controls), *entry_index_by_name]
        )
        for control in inherited_controls:
            self._warn_of_lost_drive(control)
        controls = (
            *inherited_controls,
            *(
                self._read_control(("controls", i), control, known_shapes)
                for i, control in enumerate(self.model.controls)
            ),
        )
        try:
            evaluation_order(controls)
        except DependencyCycleError as error:
            cycle = error.cycle[::-1]
            first_in_file = next(name for name in cycle if name in entry_index_by_name)
            message = f"controls drive each other in a cycle: {cycle_text(cycle)}"
            self.document.add(
                "RIG014", ("controls", entry_index_by_name[first_in_file]), message
            )
        return controls

    def _warn_of_lost_drive(self, control: Control) -> None:
        """Record inherited drives whose joint no longer has the driven part."""
        for drive in control.drives:
            name, part = split_part(drive.target.removeprefix("joint/"), DRIVEN_PARTS)
            if not part or name in self.file_joints.untyped_joints:
                continue
            joint_type = self.joint_by_name[name].type
            if joint_type not in DRIVEN_PARTS[part]:
                message = f"its control {control.name!r} drives {name}.{part}, but a "
                message += f"{joint_type} joint has no {part}"
                hint = "keep the joint's type, or write a control with that name"
                self.document.add("RIG023", ("from",), message, hint)

    def read_chains(self, inherited_chains: Sequence[IkChain]) -> tuple[IkChain, ...]:
        """Return the chains, each tip below its root."""
        self._check_distinct("ik", "chain")
        listed_names = {chain.name for chain in self.model.ik}
        chains = [chain for chain in inherited_chains if chain.name not in listed_names]
        for i, chain in enumerate(self.model.ik):
            location = ("ik", i)
            is_known_end = [
                self.check_joint((*location, key), getattr(chain, key))
                for key in ("root", "tip")
            ]
            if all(is_known_end) and not self._is_descendant(chain.root, chain.tip):
                message = f"{chain.tip!r} is not below {chain.root!r}"
                hint = "name a joint below the root"
                if self._is_descendant(chain.tip, chain.root):
                    hint = f"root and tip are swapped: write root: {chain.tip}, "
                    hint += f"tip: {chain.root}"
                elif chain.tip == chain.root:
                    message = f"root and tip are both {chain.tip!r}"
                self.document.add("RIG022", (*location, "tip"), message, hint)
            direction = None
            if chain.pole_dir is not None:
                where = (*location, "pole_dir")
                direction = unit_vector(self.document, where, chain.pole_dir)
            chain_fields = (chain.name, chain.root, chain.tip, chain.goal)
            chains.append(IkChain(*chain_fields, direction, chain.stretch))
        return tuple(chains)

    def read_attachments(
        self, meshes: Iterable[Mesh], inherited_attachments: Iterable[Attachment]
    ) -> tuple[Attachment, ...]:
        """Return the attachments; check their arrays."""
        self._check_distinct("attach", "attachment")
        point_count_by_mesh = {mesh.name: self._point_count(mesh) for mesh in meshes}
        reader = AttachmentReader(
            self.document,
            self.array_reader,
            point_count_by_mesh,
            self.check_joint,
            lambda location, name: self._check_known(
                location, name, point_count_by_mesh, "mesh"
            ),
        )
        listed_names = {entry.name for entry in self.model.attach}
        return (
            *(
                entry
                for entry in inherited_attachments
                if entry.name not in listed_names
                and not (entry.mesh and self.model.meshes)
            ),
            *(
                reader.read_attachment(("attach", i), entry)
                for i, entry in enumerate(self.model.attach)
            ),
        )

    def _point_count(self, mesh: Mesh) -> int | None:
        """Return the point count of a mesh; None if it cannot be read."""
        if mesh.name in self.point_counts:
            return self.point_counts[mesh.name]
        return self.array_reader.row_count(mesh.points)

    def read_colliders(
        self, inherited_colliders: Sequence[Collider]
    ) -> tuple[Collider, ...]:
        """Return the colliders."""
        listed_joints = {entry.joint for entry in self.model.colliders}
        colliders = [
            collider
            for collider in inherited_colliders
            if collider.joint not in listed_joints
        ]
        for i, entry in enumerate(self.model.colliders):
            location = ("colliders", i)
            self.check_joint((*location, "joint"), entry.joint)
            model, unit = entry.capsule, self.units.length
            axis = unit_vector(
                self.document, (*location, "capsule", "axis"), model.axis
            )
            offset = scale_vector(model.offset, unit)
            capsule = Capsule(model.radius * unit, model.length * unit, axis, offset)
            colliders.append(Collider(entry.joint, capsule))
        return tuple(colliders)

    def _read_mesh(self, location: Location, mesh: MeshModel) -> Mesh:
        """Return a mesh; check its arrays."""
        points = self.array_reader.read_array(
            location, mesh.points, "points", (None, 3)
        )
        point_count = self.point_counts.get(mesh.name)
        if point_count is None:
            point_count = self.array_reader.row_count(points)
        if point_count is not None:
            self.point_counts[mesh.name] = point_count
        faces = self.array_reader.read_array(
            location, mesh.faces, "faces", (None, None), point_count
        )
        return Mesh(
            mesh.name,
            points,
            faces,
            self.array_reader.read_optional_array(
                location, mesh.normals, "normals", (point_count, 3)
            ),
            None if mesh.geom_bind is None else tuple(mesh.geom_bind),
            None
            if mesh.skin is None
            else self._read_skin((*location, "skin"), mesh.skin, point_count),
            None if mesh.subdivision is None else Subdivision(mesh.subdivision),
        )

    def _read_skin(
        self, location: Location, skin: SkinModel, point_count: int | None
    ) -> Skin:
        """Return the skin binding of a mesh; check its joints and arrays."""
        for k, name in enumerate(skin.joints):
            self.check_joint((*location, "joints", k), name)
        joint_count = None
        if not self.document.is_placeholder((*location, "joints")):
            joint_count = len(skin.joints)
        indices = self.array_reader.read_array(
            location, skin.indices, "indices", (point_count, None), joint_count
        )
        shape = self.array_reader.array_shape(indices) or ()
        influence_count = shape[1] if len(shape) == 2 else None
        weights = self.array_reader.read_array(
            location, skin.weights, "weights", (point_count, influence_count)
        )
        return Skin(skin.method, tuple(skin.joints), indices, weights)

    def _read_control(
        self, location: Location, model: ControlModel, shapes: Collection[str]
    ) -> Control:
        """Return a control; check its name, range and drives."""
        name = model.name
        reason = _name_problem(name)
        if reason:
            message = f"{name!r} cannot name a control in an expression: {reason}"
            hint = "rename it: letters, digits and underscores"
            self.document.add("RIG025", (*location, "name"), message, hint)
        low, high = model.range or (None, None)
        is_certain = not self.document.is_placeholder((*location, "range"))
        if low is not None and high is not None and is_certain:
            if low > high:
                message = f"the range from {low:g} to {high:g} is reversed"
                hint = f"write [{high:g}, {low:g}]"
                self.document.add("RIG017", (*location, "range"), message, hint)
            elif not low <= model.default <= high:
                message = f"default {model.default:g} is not in {low:g} to {high:g}"
                self.document.add("RIG017", (*location, "default"), message)
        drives = (
            self._read_drive((*location, "drives", k), drive, shapes)
            for k, drive in enumerate(model.drives)
        )
        valid_drives = tuple(filter(None, drives))
        driver = self._read_driver((*location, "driven"), model.driven)
        return Control(name, low, high, model.default, valid_drives, driver)

    def _read_driver(
        self, location: Location, model: DrivenModel | None
    ) -> Driver | None:
        """Return the driver of a shape or a control."""
        if model is None:
            return None
        units = (self.units.length, self.units.angle)
        return read_driver(self.document, location, model, units, 1.0)

    def _read_drive(
        self, location: Location, model: DriveModel, shapes: Collection[str]
    ) -> Drive | None:
        """Return a control's drive, or None after recording a fault."""
        target_kinds = [
            k for k in ("shape", "joint", "control") if getattr(model, k) is not None
        ]
        if len(target_kinds) != 1:
            message = f"drives {' and '.join(target_kinds) or 'nothing'}"
            self.document.add(
                "RIG015", location, message, "write one of shape, joint, control"
            )
            return None
        if (model.expr is None) == (model.curve is None):
            message = (
                "has both expr and curve" if model.expr else "has no expr or curve"
            )
            self.document.add(
                "RIG015", location, message, "write one of them for the amount"
            )
            return None
        target, unit = self._read_target(
            (*location, target_kinds[0]), target_kinds[0], model, shapes
        )
        if model.expr is not None:
            check_no_interpolation(self.document, location, model.interp)
            expression = self._read_expression((*location, "expr"), model.expr)
            return Drive(target, expression, (), unit) if expression else None
        points = tuple((x, y) for x, y in model.curve or ())
        values = [x for x, _ in points]
        is_smooth = model.interp == "smooth"
        if list(record_descents(self.document, (*location, "curve"), values)):
            is_smooth = False
        return Drive(target, None, points, unit, is_smooth)

    def _read_expression(
        self, location: Location, expression_text: str
    ) -> Expression | None:
        """Return an expression over controls, or None after recording a fault."""
        try:
            expression = parse_expression(expression_text)
        except ValueError as error:
            if not self._reads_misnamed_control(expression_text):
                self.document.add("RIG013", location, str(error))
            return None
        if self.control_names.keys() >= set(
            expression.names
        ) or not self._reads_misnamed_control(expression_text):
            for name in expression.names:
                self._check_known(location, name, self.control_names, "control")
        return expression

    def _reads_misnamed_control(self, text: str) -> bool:
        """Return whether an expression reads a misnamed control (RIG025)."""
        return any(
            re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text)
            for name in self.control_names
            if name and _name_problem(name)
        )

    def _read_target(
        self, location: Location, kind: str, model: DriveModel, shapes: Collection[str]
    ) -> tuple[str, float]:
        """Return a drive's target, and the unit of its values."""
        name = str(getattr(model, kind))
        if kind != "joint":
            known_names = shapes if kind == "shape" else self.control_names
            self._check_known(location, name, known_names, kind)
            return f"{kind}/{name}", 1.0
        joint, part = split_part(name, DRIVEN_PARTS)
        if not part:
            message, hint = self._part_fault(name)
            self.document.add("RIG015", location, message, hint)
        elif self.check_joint(location, joint):
            types = DRIVEN_PARTS[part]
            has_known_type = joint not in self.file_joints.untyped_joints
            if has_known_type and self.joint_by_name[joint].type not in types:
                fitting_parts = [
                    p
                    for p, t in DRIVEN_PARTS.items()
                    if self.joint_by_name[joint].type in t
                ]
                message = f"a {self.joint_by_name[joint].type} joint has no {part}"
                hint = f"it has {', '.join(fitting_parts) or 'nothing that moves'}"
                self.document.add("RIG015", location, message, hint)
        is_length = part == "slide" or part.startswith("translation")
        unit = self.units.length if is_length else self.units.angle
        return f"joint/{name}", unit

    def _part_fault(self, target_name: str) -> tuple[str, str]:
        """Return message and hint for a drive whose target lacks a valid joint part."""
        joint, _, part = target_name.rpartition(".")
        if target_name in self.joint_by_name:
            joint, message = target_name, f"missing part of joint {target_name!r}"
        elif joint in self.joint_by_name:
            message = f"unknown part {part!r} of joint {joint!r}"
        else:
            return f"missing part of joint {target_name!r}", part_hint(
                target_name, DRIVEN_PARTS
            )
        has_type = joint not in self.file_joints.untyped_joints
        joint_type = self.joint_by_name[joint].type if has_type else None
        return message, part_hint(target_name, DRIVEN_PARTS, joint_type)

    def _check_distinct(self, section_key: str, kind: str) -> None:
        """Record a fault for each entry that has the name of an earlier entry."""
        first_index_by_name: dict[str, int] = {}
        for i, entry in enumerate(getattr(self.model, section_key)):
            if entry.name in first_index_by_name:
                line = self.document.position(
                    (section_key, first_index_by_name[entry.name])
                )[0]
                message = f"duplicate {kind} {entry.name!r}"
                hint = f"the first is on line {line}"
                self.document.add("RIG011", (section_key, i, "name"), message, hint)
            first_index_by_name.setdefault(entry.name, i)

    def check_joint(self, location: Location, name: str) -> bool:
        """Return whether a joint exists; record a fault otherwise."""
        return self._check_known(location, name, self.joint_by_name, "joint")

    def _check_known(
        self, location: Location, name: str, known_names: Collection[str], kind: str
    ) -> bool:
        """Return whether a name exists; record a fault otherwise."""
        if name in known_names:
            return True
        has_unknown_name = self.document.has_unknown_name(_LIST_KEY_BY_KIND[kind])
        if not (
            self.file_joints.has_unknown_name if kind == "joint" else has_unknown_name
        ):
            code = "RIG008" if kind == "joint" else "RIG012"
            self.document.add(
                code, location, f"unknown {kind} {name!r}", name_hint(name, known_names)
            )
        return False

    def _is_descendant(self, root: str, tip: str) -> bool:
        """Return whether a tip is the root or its descendant; True if unknown."""
        joints = self.file_joints.joints
        index = next(i for i, joint in enumerate(joints) if joint.name == tip)
        while index >= 0 and joints[index].name != root:
            if joints[index].name in self.file_joints.orphaned_joints:
                return True
            index = joints[index].parent
        return index >= 0


def _name_problem(name: str) -> str:
    """Return why an expression cannot use a name; empty if it can."""
    if not name.isidentifier():
        return "an expression would not read it as one name"
    if keyword.iskeyword(name):
        return "it is a keyword of Python"
    if name in FUNCTIONS:
        return "it is a function of expressions"
    return "it is a constant of expressions" if name == "pi" else ""
