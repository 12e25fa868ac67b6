"""Codes of files, settings and options."""

from __future__ import annotations

from animtool.errors import Severity
from animtool.validation.rule import Rule

__all__ = ["RULES"]

RULES = (
    Rule("CFG001", "settings that cannot be read"),
    Rule("CFG002", "an unknown setting"),
    Rule("CFG003", "a setting of a wrong value"),
    Rule("CLI002", "options that exclude or need each other"),
    Rule("CLI003", "a prim path or unit that is none"),
    Rule("CLI004", "an option that is not for this file"),
    Rule("CLI005", "a range or rate that does not fit the take"),
    Rule("CLI006", "in Python: a frame rate that is none"),
    Rule("CLI101", "a `--range` that reaches beyond the take", Severity.WARNING),
    Rule("CLI102", "`--keep-curves` where no control has a curve", Severity.WARNING),
    Rule("CLI103", "settings of a scene that a library does not use", Severity.WARNING),
    Rule(
        "CLI104",
        "`--physics` writes a rig, and its source has motion, which is left out",
        Severity.NOTE,
    ),
    Rule("CLI105", "a `--range` whose ends have no sample", Severity.NOTE),
    Rule("DOC001", "no YAML, or a number too long"),
    Rule("DOC002", "an anchor or alias"),
    Rule("DOC003", "a tag"),
    Rule("DOC004", "a key that stands twice"),
    Rule("DOC005", "nested too deep"),
    Rule("DOC006", "larger than 32 MB"),
    Rule("DOC007", "empty, no mapping, or more than one document"),
    Rule("DOC008", "not UTF-8"),
    Rule("DOC009", "another kind of file"),
    Rule("DOC010", "a key that is no text, or a text with commas that wants quotes"),
    Rule("DOC011", "more faults than are shown"),
    Rule("DOC012", "a version that this animtool does not know"),
    Rule("DOC013", "an older version, which migrate rewrites"),
    Rule("DOC020", "an unknown key"),
    Rule("DOC021", "a key missing"),
    Rule("DOC022", "a value of the wrong type, length or range"),
    Rule("DOC023", "a control character, or a key of several lines"),
    Rule("DOC024", "more values than are read"),
    Rule("DOC025", "a text or a key that is too long"),
    Rule("DOC101", "comments that `migrate` does not keep", Severity.WARNING),
    Rule("DOC102", "a key that has a new name", Severity.WARNING),
    Rule("IO001", "a file that cannot be read"),
    Rule("IO002", "a file of a kind that is not read"),
    Rule("IO003", "a plug-in reader that cannot be loaded"),
    Rule("IO004", "a file that changed while it was read"),
    Rule("IO010", "a file that is too large"),
    Rule("OUT001", "an output that exists"),
    Rule("OUT002", "an output that cannot be written"),
    Rule("OUT003", "an output that is also an input"),
    Rule("OUT004", "an output of an unknown kind"),
    Rule("OUT005", "an output that is not a file"),
    Rule("OUT006", "an unsafe name in an output"),
    Rule("OUT007", "two outputs that are one file"),
)
