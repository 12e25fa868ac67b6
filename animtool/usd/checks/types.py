"""Attributes whose type is not that of their schema, on which other checks give up."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pxr import Sdf, Usd

from animtool.errors import Fault
from animtool.usd.checks.subject import Subject
from animtool.usd.checks.table import finding


def check_types(subject: Subject) -> Iterator[Fault]:
    """Check that the strongest opinion on an attribute is of its schema's type.

    Properties of SkelBindingAPI count where it is not applied, too, and inbetweens.
    """
    for attr in subject.attributes:
        found, wanted = attr.GetPropertyStack()[0].typeName, _wanted(attr)
        if wanted is not None and found.type != wanted.type:
            message = f"it is {found}, its schema has {wanted}; more may be wrong there"
            yield finding("USD280", attr.GetPath(), message)


def _wanted(attr: Any) -> Any:
    """Return the type that an attribute should have, None where any will do."""
    name = attr.GetName()
    if name.startswith("inbetweens:"):
        return Sdf.ValueTypeNames.Vector3fArray
    binding = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition("SkelBindingAPI")
    for definition in (attr.GetPrim().GetPrimDefinition(), binding):
        found = definition.GetAttributeDefinition(name)
        if found:
            return found.GetTypeName()
    return None
