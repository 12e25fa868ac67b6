"""Codes of scenes and passes."""

from __future__ import annotations

from functools import partial

from animtool.errors import Severity
from animtool.validation.rule import Kind, Rule, own_rule

__all__ = ["RULES"]

_rule = partial(own_rule, Kind.SCENE)


RULES = (
    Rule("SCN001", "an option that a pass has not"),
    Rule("SCN002", "an option of a wrong value"),
    Rule("SCN003", "a range reversed, or a frame rate or length that is none"),
    Rule("SCN004", "a file outside the project"),
    Rule("SCN005", "a file that is not there"),
    Rule("SCN010", "no pass of that name"),
    Rule("SCN011", "a plug-in pass that cannot be loaded"),
    Rule("SCN012", "a name or pattern that matches no joint"),
    Rule("SCN013", "a frame outside the take, or a range that is empty or reversed"),
    Rule("SCN014", "a weight that is not finite, or not from 0 to 1"),
    Rule("SCN015", "a curve that is malformed, or whose times do not ascend"),
    Rule("SCN016", "a speed that is 0 or not finite"),
    Rule("SCN017", "takes of different rigs"),
    Rule("SCN018", "no cycle or repeat to make a loop of, or none found"),
    Rule("SCN019", "mirror pairs that are none, or do not hang from partners"),
    Rule("SCN020", "a root joint that cannot take the travel, or be folded back"),
    Rule("SCN021", "more than 10 million frames"),
    Rule("SCN022", "a frame rate that is none"),
    Rule("SCN023", "a base whose scale is 0"),
    Rule("SCN024", "an option that must name another take"),
    Rule("SCN025", "in Python: a word that is none of those an option has"),
    Rule("SCN030", "a variable that has no value"),
    Rule("SCN031", "a variable of the command line that no scene uses"),
    Rule("SCN032", "a `${` without a name and `}`, or a variable of no name"),
    Rule("SCN033", "a time code that is none"),
    Rule("SCN034", "a source without the time code that another has"),
    Rule("SCN035", "a source that has no frame of the first"),
    Rule("SCN036", "a source that has or brings nothing of the rig"),
    Rule("SCN037", "a track that a source has not"),
    Rule("SCN038", "tracks or time code of the one or the first source"),
    Rule("SCN039", "a setting that a kind of output, or one of several, has not"),
    Rule("SCN040", "two outputs that write one file"),
    Rule("SCN041", "a range beside a shot"),
    Rule("SCN042", "a frame of the cut that the take has not"),
    Rule("SCN043", "no pass of the scene to stop at"),
    Rule("SCN044", "outputs that both a batch and its scene name"),
    Rule("SCN045", "a pass that loses what is beside the rig"),
    Rule("SCN046", "two things beside the character at one path"),
    Rule("SCN047", "a thing beside the character at a path of the character"),
    Rule("SCN048", "a thing beside the character that is not there"),
    Rule("SCN049", "an attribute beside the character that cannot be read"),
    Rule("SCN050", "a take that a clip library has already"),
    Rule("SCN051", "a file that no take can be added to"),
    Rule("SCN052", "a library as the output of a batch"),
    Rule("SCN060", "what scenes have only with, or only without, a source"),
    Rule("SCN061", "a simulation without an end"),
    Rule("SCN062", "what is for characters, of a scene that is simulated"),
    Rule(
        "SCN101",
        "a loop whose ends differ by more than a fifth of what it moves",
        Severity.WARNING,
    ),
    Rule("SCN102", "the cycle that was found", Severity.NOTE),
    Rule("SCN103", "frames that a source lacks, held", Severity.WARNING),
    Rule("SCN104", "frames of a source that are left out", Severity.NOTE),
    Rule("SCN105", "tracks that two sources bring", Severity.WARNING),
    Rule("SCN106", "handle frames that the take has not", Severity.WARNING),
    Rule("SCN107", "frames at which a prop is held", Severity.WARNING),
    Rule("SCN108", "a camera that does not state its lens", Severity.WARNING),
    Rule("SCN109", "a prop that does not move", Severity.NOTE),
    Rule("SCN110", "a prop of another rate", Severity.NOTE),
    Rule("SCN111", "a prop that is sheared", Severity.NOTE),
    Rule("SCN112", "props that an output has no place for", Severity.NOTE),
    Rule("SCN113", "a prop that is sheared between its keys", Severity.NOTE),
    _rule("SCN201", "a pass that changes nothing", "scene_passes:idle"),
    _rule("SCN202", "a range beyond the take", "scene_passes:outside_take"),
    _rule(
        "SCN203",
        "an output that is an input",
        "scene_output:over_input",
        Severity.ERROR,
    ),
    _rule(
        "SCN204",
        "an output that another scene writes too",
        "scene_output:over_other",
    ),
    _rule("SCN205", "a rate that is nearly the take's", "scene_passes:near_rate"),
    _rule("SCN206", "a rig that the source does not use", "scene_passes:unused_rig"),
    _rule(
        "SCN207",
        "options of the output that a bake refuses",
        "scene_output:refused",
        Severity.ERROR,
    ),
    _rule(
        "SCN208",
        "`keep_curves` where no control has a curve",
        "scene_output:without_curves",
    ),
    _rule("SCN209", "a variable that nothing uses", "scene_variables:idle"),
    _rule(
        "SCN210",
        "a pass that moves what ik brought to targets",
        "scene_passes:undone_goals",
    ),
    _rule(
        "SCN211",
        "a range without a frame of the take",
        "scene_passes:without_frames",
        Severity.ERROR,
    ),
    _rule("SCN212", "an output in a folder that is not there", "scene_output:homeless"),
    _rule(
        "SCN213",
        "something beside the character that has no frame of the take",
        "scene_beside:out_of_time",
    ),
)
