"""Codes of validation itself."""

from __future__ import annotations

from animtool.errors import Severity
from animtool.validation.rule import Rule

RULES = (
    Rule("VAL001", "an entry of ignore that hides nothing", Severity.WARNING),
    Rule("VAL002", "an entry of ignore with a code that there is none of"),
    Rule("VAL003", "a rule that failed"),
    Rule("VAL004", "a plug-in rule that cannot be loaded"),
    Rule("VAL005", "a code, or the beginning of codes, that there is none of"),
    Rule("VAL006", "no file to check"),
    Rule("VAL007", "a clip that names no rig", Severity.NOTE),
    Rule("VAL008", "a severity profile that is malformed"),
    Rule("VAL009", "an unknown severity profile"),
)
