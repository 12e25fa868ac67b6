"""Codes of batches."""

from __future__ import annotations

from animtool.validation.rule import Rule

__all__ = ["RULES"]

RULES = (
    Rule("BAT001", "both a scene and options"),
    Rule("BAT002", "a length, rate, size, range or name that is none"),
    Rule("BAT003", "a file that is not there, or outside the project"),
    Rule("BAT004", "a name in an output that there is none of"),
    Rule("BAT005", "no input"),
    Rule("BAT006", "two items that write one file"),
    Rule("BAT010", "another run of the same batch"),
    Rule("BAT011", "a record of earlier runs that cannot be read"),
    Rule("BAT012", "a record that cannot be written"),
    Rule("BAT020", "an item whose process ended"),
    Rule("BAT021", "an item that took too long"),
    Rule("BAT022", "an item that took too much memory"),
    Rule("BAT023", "an item that failed unexpectedly"),
    Rule("BAT030", "no executor of that name"),
    Rule("BAT031", "an executor that cannot do what is asked"),
    Rule("BAT032", "a plug-in executor that cannot be loaded"),
    Rule("BAT033", "items that are not there"),
)
