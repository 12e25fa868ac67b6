"""Matches the markers of a template to those of a capture."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import compress

import numpy as np

from animtool.capture.templates.template import MarkerTemplate
from animtool.core.arguments import argument
from animtool.core.array_types import IntArray
from animtool.core.errors import Fault, OptionError, counted, listed
from animtool.core.names import most_similar, name_hint
from animtool.core.record import dataclass

# Largest number of names in a message.
MAX_LISTED_NAMES = 6


@dataclass(frozen=True, slots=True)
class MarkerMatch:
    """Indices of a template's markers in a capture, and names without a match.

    Attributes:
        columns: Index of each template marker in the capture ``(M,)``; -1
            if the capture lacks it.
        missing: Names of the template's markers that the capture lacks.
        unused: Names in the capture that the template does not know.
        subject: The prefix that the names have before a colon; empty for none.
    """

    columns: IntArray
    missing: tuple[str, ...]
    unused: tuple[str, ...]
    subject: str = ""


def match_markers(
    template: MarkerTemplate, names: Sequence[str], subject: str | None = None
) -> MarkerMatch:
    """Return the indices of a template's markers among the names of a capture.

    A name matches with or without its subject prefix (``Ann:LFHD``), and by its
    aliases. Unlabelled points do not match.

    Args:
        template: The markers.
        names: Names of the capture's markers.
        subject: Prefix of the names to match; None takes the only one, or the names
            without a prefix.

    Raises:
        OptionError: No name matches (SOL001), or names of several subjects do (SOL002).

    >>> from animtool.capture.templates.template import TemplateMarker
    >>> template = MarkerTemplate((TemplateMarker("LFHD", "head"),))
    >>> match_markers(template, ["*0", "Ann:LFHD"]).columns.tolist()
    [1]
    """
    labelled_names = [name for name in names if not name.startswith("*")]
    columns_by_subject = {
        prefix: _marker_columns(template, names, prefix)
        for prefix in dict.fromkeys(_split_prefix(name)[0] for name in labelled_names)
    }
    columns_by_matching_subject = {
        prefix: columns
        for prefix, columns in columns_by_subject.items()
        if (columns >= 0).any()
    }
    if subject is not None:
        if subject not in columns_by_subject:
            message = f"no marker is of the subject {subject!r}"
            raise OptionError(
                Fault("SOL001", message, hint=name_hint(subject, columns_by_subject))
            )
        columns_by_matching_subject = {subject: columns_by_subject[subject]}
        labelled_names = [
            name for name in labelled_names if _split_prefix(name)[0] == subject
        ]
    if len(columns_by_matching_subject) > 1:
        count_text = counted(len(columns_by_matching_subject), "subject")
        message = f"holds markers of {count_text}: "
        message += f"{listed(sorted(columns_by_matching_subject))}"
        hint = f"choose one with {argument('subject')}"
        raise OptionError(Fault("SOL002", message, hint=hint))
    if (
        not columns_by_matching_subject
        or not (next(iter(columns_by_matching_subject.values())) >= 0).any()
    ):
        raise OptionError(_unmatched_fault(template, labelled_names, names))
    ((subject, columns),) = columns_by_matching_subject.items()
    used_columns = set(columns[columns >= 0].tolist())
    missing_markers = tuple(compress(template.names, columns < 0))
    unused_names = [
        name
        for i, name in enumerate(names)
        if i not in used_columns and not name.startswith("*")
    ]
    return MarkerMatch(columns, missing_markers, tuple(unused_names), subject)


def _split_prefix(name: str) -> tuple[str, str]:
    """Split ``Ann:LFHD`` into subject and marker name; the subject may be empty."""
    subject, _, bare_name = name.rpartition(":")
    return subject.strip(), bare_name.strip()


def _marker_columns(
    template: MarkerTemplate, names: Sequence[str], subject: str
) -> IntArray:
    """Return the index of each marker among a subject's ``names``; -1 if missing."""
    bare_names = {
        i: bare_name
        for i, (prefix, bare_name) in enumerate(map(_split_prefix, names))
        if prefix == subject and not names[i].startswith("*")
    }
    columns = np.full(len(template.markers), -1, np.int64)
    used_columns: set[int] = set()
    # Exact spelling first, then ignoring case.
    for normalise in (str, str.casefold):
        column_by_name: dict[str, int] = {}
        for i, bare_name in bare_names.items():
            column_by_name.setdefault(normalise(bare_name), i)
        for m, marker in enumerate(template.markers):
            for name in (marker.name, *marker.aliases):
                i = column_by_name.get(normalise(name), -1)
                if columns[m] < 0 <= i and i not in used_columns:
                    columns[m] = i
                    used_columns.add(i)
    return columns


def resembling_names(
    names: Sequence[str], captured_names: Sequence[str]
) -> list[tuple[str, str]]:
    """Return pairs of a template's and a capture's names that resemble each other.

    Each is the most similar name of the other; subject prefixes, case and punctuation
    do not matter. The captured names are returned without their prefix.

    >>> resembling_names(["LASI", "RASI"], ["Ann:L_ASIS", "Ann:C7"])
    [('LASI', 'L_ASIS')]
    """
    name_by_captured_letters = {
        _letters_of(name): _split_prefix(name)[1] for name in captured_names
    }
    name_by_letters = {_letters_of(name): name for name in names}
    pairs = []
    for letters, name in name_by_letters.items():
        similar_letters = most_similar(letters, name_by_captured_letters)
        if (
            similar_letters is not None
            and most_similar(similar_letters, name_by_letters) == letters
        ):
            pairs.append((name, name_by_captured_letters[similar_letters]))
    return pairs


def _letters_of(name: str) -> str:
    """Return a name's lower-case letters and digits, without its subject prefix."""
    return re.sub(r"[^a-z0-9]", "", _split_prefix(name)[1].lower())


def _unmatched_fault(
    template: MarkerTemplate, labelled_names: Sequence[str], names: Sequence[str]
) -> Fault:
    """Return a fault that no marker of the template matches, with similar names."""
    message = "no marker of the capture has a name of the template"
    if not labelled_names:
        message = f"none of the {counted(len(names), 'point')} has a label"
        hint = "animtool mocap label gives points their names"
        return Fault("SOL001", message, hint=hint)
    suggestions = [
        f"{name!r} is near {similar_name!r}"
        for name, similar_name in resembling_names(template.names, labelled_names)
    ]
    suggestions_text = ", ".join(suggestions[:MAX_LISTED_NAMES])
    hint = f"{suggestions_text}: rename them in the template, or add aliases"
    if not suggestions:
        suggestions_text = listed(labelled_names, MAX_LISTED_NAMES)
        hint = f"the capture has {suggestions_text}; add them to aliases of the "
        hint += "template"
    return Fault("SOL001", message, hint=hint)
