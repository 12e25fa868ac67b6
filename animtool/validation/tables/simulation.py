"""Codes of simulation."""

from __future__ import annotations

from animtool.errors import Severity
from animtool.validation.rule import Rule

__all__ = ["RULES"]

RULES = (
    Rule("SIM001", "an integrator that there is none of"),
    Rule("SIM002", "times that run backwards, are not finite, or none"),
    Rule("SIM003", "a start or a rate that is not finite, or of another shape"),
    Rule("SIM004", "an option of integrating that is out of its range"),
    Rule("SIM005", "a step that is missing, or a tolerance that is not heeded"),
    Rule("SIM006", "an integrator that is not for such a system"),
    Rule("SIM020", "a collider that makes no sense"),
    Rule("SIM021", "an emitter that makes no sense"),
    Rule("SIM022", "a force that makes no sense"),
    Rule("SIM023", "a force that there is none of"),
    Rule("SIM024", "particles that make no sense"),
    Rule("SIM030", "attachments that a rig has not"),
    Rule("SIM031", "an option of simulating that is out of its range"),
    Rule("SIM032", "options of simulating that do not go together"),
    Rule("SIM033", "an attachment that cannot be simulated"),
    Rule("SIM034", "joints that would move away from what is simulated"),
    Rule("SIM035", "a file of states that does not fit"),
    Rule("SIM040", "a mass that is not above 0"),
    Rule("SIM041", "a position that is not finite"),
    Rule("SIM042", "a spring that cannot be"),
    Rule("SIM043", "a pin or target of no particle"),
    Rule("SIM044", "a path that does not fit"),
    Rule("SIM050", "a rope, cloth or volume that makes no sense"),
    Rule("SIM051", "a mesh or tetrahedra that cannot be simulated"),
    Rule("SIM052", "particles to hold that there are none of"),
    Rule("SIM053", "something to pin to that is not there"),
    Rule("SIM054", "systems that are joined, and contradict each other"),
    Rule("SIM101", "a step too long to be stable", Severity.WARNING),
    Rule("SIM102", "a motion that blew up", Severity.WARNING),
    Rule("SIM103", "a step that had to be shorter than it may", Severity.WARNING),
    Rule("SIM104", "a motion that took more evaluations than it may", Severity.WARNING),
    Rule("SIM105", "an implicit step without a solution", Severity.WARNING),
    Rule("SIM120", "a collider that is put elsewhere at once", Severity.WARNING),
    Rule("SIM121", "more particles than there is room for", Severity.WARNING),
    Rule("SIM130", "what a simulation came to", Severity.NOTE),
    Rule("SIM131", "springs that are longer than they may be", Severity.WARNING),
    Rule("SIM132", "particles that stay inside colliders", Severity.WARNING),
    Rule("SIM133", "a cycle that does not come round", Severity.WARNING),
    Rule("SIM134", "points that are simulated and not written", Severity.WARNING),
    Rule("SIM140", "springs whose ends are at one place", Severity.WARNING),
    Rule("SIM141", "a spring longer than it may be", Severity.WARNING),
    Rule("SIM142", "an error that was not kept", Severity.WARNING),
    Rule("SIM143", "particles of springs inside colliders", Severity.WARNING),
    Rule("SIM150", "particles that begin where springs pull", Severity.WARNING),
    Rule("SIM152", "a rest that was not found", Severity.WARNING),
    Rule("SIM153", "a mesh that is odd for cloth", Severity.WARNING),
)
