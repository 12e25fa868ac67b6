"""Codes of batches."""

from __future__ import annotations

from animtool.errors import Severity
from animtool.validation.rule import Rule

__all__ = ["RULES"]

RULES = (
    Rule("BAT001", "a scene with options"),
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
    Rule("BAT034", "an executor whose package is missing"),
    Rule("BAT035", "a cluster that cannot be used"),
    Rule("BAT036", "a worker of other versions"),
    Rule("BAT037", "no report of costs"),
    Rule("BAT038", "no file of path mapping rules"),
    Rule("BAT040", "cut lists without OpenTimelineIO"),
    Rule("BAT041", "no timeline"),
    Rule("BAT042", "media of a clip that is missing"),
    Rule("BAT043", "what is not taken from a timeline as it is", Severity.NOTE),
    Rule("BAT044", "a clip that plays backwards or stands still"),
    Rule("BAT046", "a shot called otherwise than its clip", Severity.NOTE),
    Rule("BAT047", "metadata of a timeline that cannot be used"),
    Rule("BAT048", "unknown shot, or several shots and none named"),
    Rule("BAT049", "a timeline whose clips have several rates", Severity.NOTE),
    Rule("BAT050", "several timelines"),
    Rule("BAT051", "another rate than the timeline has"),
    Rule("BAT060", "a scene that makes the same of all items"),
    Rule("BAT061", "a table of variants without values"),
    Rule("BAT062", "a row of variants with other columns"),
    Rule("BAT063", "a column of variants that cannot be called so"),
    Rule("BAT064", "an invalid value of a variant"),
    Rule("BAT065", "too many variants, or none"),
    Rule("BAT070", "a record of earlier runs that is damaged", Severity.WARNING),
    Rule("BAT071", "processes that cannot be started"),
)
