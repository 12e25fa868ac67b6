"""Names that people write: what a variable may be called, and the nearest valid one."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import islice

from animtool.errors import Fault, OptionError
from animtool.similar import similar

# What stands in for a name that is missing, and is none.
UNKNOWN = "?"
# Valid names that a hint is looked for among.
MAX_NAMES = 2000
# Of variables: a regular expression.
VARIABLE_NAME = r"[A-Za-z_][A-Za-z0-9_]*"


def is_variable_name(text: str) -> bool:
    """Return whether a variable may have a name.

    >>> is_variable_name("shot_2"), is_variable_name("2nd shot")
    (True, False)
    """
    return re.fullmatch(VARIABLE_NAME, text) is not None


def nearest(name: str, names: Iterable[str]) -> str:
    """Return a hint that names the nearest valid name, or the valid ones.

    >>> nearest("ebow", ["elbow", "hand"])
    "did you mean 'elbow'?"
    """
    known = list(dict.fromkeys(islice(names, MAX_NAMES)))
    known = [one for one in known if one != UNKNOWN]
    near = similar(name, known)
    if near:
        return f"did you mean {near!r}?"
    if not known:
        return "there is none"
    return f"allowed: {', '.join(known[:12])}" + (" …" if len(known) > 12 else "")


def check_given(given: Iterable[str], used: Iterable[str]) -> None:
    """Refuse variables that are given and that nothing uses.

    Raises:
        OptionError: With a fault for each (SCN031).

    >>> check_given(["shot"], ["shot", "rate"])
    """
    names = sorted(used)
    faults = [
        Fault("SCN031", f"no scene uses a variable {name!r}", hint=nearest(name, names))
        for name in given
        if name not in names
    ]
    if faults:
        raise OptionError(faults)
