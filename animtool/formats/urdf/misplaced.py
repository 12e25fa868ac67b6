"""Finds elements and attributes of a URDF that are misplaced or misspelt."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from animtool.core.errors import Severity
from animtool.core.names import most_similar
from animtool.core.record import dataclass
from animtool.formats.robots.diagnostics import XmlDiagnostics, element_label
from animtool.formats.robots.xml import XmlElement

# Elements that each element may hold. Other elements are extensions, which may hold
# any; materials are not read anywhere.
_CHILD_TAGS = {
    "robot": ("link", "joint"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("parent", "child", "origin", "axis", "limit", "mimic", "dynamics"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
    **dict.fromkeys(
        ("parent", "child", "origin", "axis", "limit", "mimic", "mass", "inertia"), ()
    ),
}
STANDARD_TAGS = frozenset(tag for tags in _CHILD_TAGS.values() for tag in tags)
_ATTRIBUTE_NAMES = {
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity"),
    "mimic": ("joint", "multiplier", "offset"),
    "mass": ("value",),
}
# Maximum number of warnings; more usually have one cause.
MAX_WARNINGS = 20
# Similarity of a tag or an attribute to the one that is likely meant.
_MIN_SIMILARITY = 0.65


@dataclass(frozen=True, slots=True)
class _ElementContext:
    """An element and its ancestors, the innermost first."""

    element: XmlElement
    ancestors: Sequence[XmlElement]


def warn_about_misplaced(root: XmlElement, diagnostics: XmlDiagnostics) -> None:
    """Warn about known elements inside elements that cannot hold them (URD112).

    Elements and attributes whose name is nearly that of a missing one are included.
    """
    last_count = len(diagnostics.notices) + MAX_WARNINGS
    for ancestors in _standard_elements(root):
        parent = ancestors[0]
        known_tags, tags = _CHILD_TAGS[parent.tag], {c.tag for c in parent.children}
        missing_tags = [tag for tag in known_tags if tag not in tags]
        for element in parent.children:
            context = _ElementContext(element, ancestors)
            if element.tag in known_tags:
                _warn_about_attributes(context, diagnostics)
            elif element.tag in STANDARD_TAGS:
                _warn_about_element(context, diagnostics)
            elif meant_tag := most_similar(element.tag, missing_tags, _MIN_SIMILARITY):
                message = f"<{element.tag[:40]}> in <{parent.tag}> is not read"
                _add_warning(
                    diagnostics, context, message, f"did you mean <{meant_tag}>?"
                )
            if len(diagnostics.notices) >= last_count:
                return


def _standard_elements(root: XmlElement) -> Iterator[Sequence[XmlElement]]:
    """Yield the elements that are not in extensions, each followed by its ancestors."""
    pending: list[tuple[XmlElement, ...]] = [(root,)]
    while pending:
        ancestors = pending.pop()
        yield ancestors
        standard_children = (c for c in ancestors[0].children if c.tag in _CHILD_TAGS)
        pending += reversed([(child, *ancestors) for child in standard_children])


def _warn_about_element(context: _ElementContext, diagnostics: XmlDiagnostics) -> None:
    """Warn about an element inside an element that cannot hold it."""
    tag, parent = context.element.tag, context.ancestors[0]
    parent_tags = [name for name, tags in _CHILD_TAGS.items() if tag in tags]
    message = f"<{tag}> in <{parent.tag}> is not read"
    hint = f"it belongs in {' or '.join(f'<{home}>' for home in parent_tags)}"
    owner = _likely_owner(context, parent_tags)
    if owner is not None and "name" in owner.attributes:
        name = owner.attributes["name"][:60]
        message += f"; {element_label(owner.tag, name)} (line {owner.line}) has none"
        if tag == "axis":
            is_slide = owner.attributes.get("type") == "prismatic"
            message += f" and {'slides along' if is_slide else 'turns about'} x"
        hint = f'move it into <{owner.tag} name="{name}">'
    _add_warning(diagnostics, context, message, hint)


def _likely_owner(
    context: _ElementContext, parent_tags: Sequence[str]
) -> XmlElement | None:
    """Return the element that should hold another: around, before or after it."""
    element = context.element
    siblings = context.ancestors[0].children
    index = next(i for i, sibling in enumerate(siblings) if sibling is element)
    candidates = [
        *context.ancestors,
        *reversed(siblings[:index]),
        *siblings[index + 1 :],
    ]
    return next(
        (c for c in candidates if c.tag in parent_tags and not c.find_all(element.tag)),
        None,
    )


def _warn_about_attributes(
    context: _ElementContext, diagnostics: XmlDiagnostics
) -> None:
    """Warn about attributes whose names are nearly those of missing ones."""
    element = context.element
    names = _ATTRIBUTE_NAMES.get(element.tag, ())
    missing_names = [name for name in names if name not in element.attributes]
    for name in element.attributes:
        if name in names or not missing_names:
            continue
        meant_name = most_similar(name, missing_names, _MIN_SIMILARITY)
        if meant_name or len(missing_names) == len(names):
            message = f"{name[:40]} of <{element.tag}> is not read"
            hint = f"did you mean {meant_name}?"
            if not meant_name:
                hint = f"its attributes are {', '.join(names)}"
            _add_warning(diagnostics, context, message, hint)


def _add_warning(
    diagnostics: XmlDiagnostics, context: _ElementContext, message: str, hint: str
) -> None:
    """Record a warning at an element, with the joint or link around it."""
    owner = next((e for e in context.ancestors if e.tag in {"joint", "link"}), None)
    name = "" if owner is None else owner.attributes.get("name", "")
    diagnostics.add(
        "URD112",
        context.element,
        message,
        hint,
        location=element_label(owner.tag, name) if owner is not None else None,
        joint=name if owner is not None and owner.tag == "joint" else None,
        severity=Severity.WARNING,
    )
