"""How well passes did, as lines of a bake and as the table of a batch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from animtool.cli.console import columns
from animtool.errors import counted, listed

if TYPE_CHECKING:
    from animtool.batch.report import ItemReport
    from animtool.scores import PassScores

# Of names in a line, and of takes in a table.
MAX_NAMED = 8
MAX_ROWS = 20


def scores_text(scores: Sequence[PassScores]) -> list[str]:
    """Return the lines of the passes of a take."""
    lines = []
    for one in scores:
        shown = ", ".join(f"{score.name} {score.text}" for score in one.scores)
        lines.append(f"{one.pass_name}: {shown}")
        lines += [
            f"  {what}: {listed(list(names), MAX_NAMED)}"
            for what, names in one.names.items()
        ]
    return lines


def scores_table(items: Sequence[ItemReport]) -> list[str]:
    """Return a table for each pass that has scores.

    Args:
        items: The worst first, as the rows are.
    """
    places = dict.fromkeys(
        (one.pass_name, one.where) for entry in items for one in entry.scores
    )
    return [line for place in places for line in _pass_table(items, place)]


def _pass_table(items: Sequence[ItemReport], place: tuple[str, str]) -> Iterator[str]:
    """Yield the lines of the pass of a name and place."""
    from animtool.batch.item import values_text

    table_rows = [
        (entry, one)
        for entry in items
        for one in entry.scores
        if (one.pass_name, one.where) == place
    ]
    names = [score.name for score in table_rows[0][1].scores]
    rows = [("  item", *names, "above usual")]
    for entry, one in table_rows[:MAX_ROWS]:
        texts = {score.name: score.text for score in one.scores}
        worse = ", ".join(score.name for score in one.worse)
        label = f"  {entry.item.output}{values_text(entry.item.values)}"
        rows.append((label, *(texts.get(name, "") for name in names), worse))
    yield f"{place[0]} ({place[1]}), the worst first:"
    yield from columns(rows, {0, len(names) + 1})
    if len(table_rows) > MAX_ROWS:
        rest = counted(len(table_rows) - MAX_ROWS, "item")
        yield f"  {rest} more, which are better; --format json has all"


def scores_json(scores: Sequence[PassScores]) -> dict[str, object]:
    """Return how well passes did as plain values, if they say it."""
    return {"scores": [one.as_dict() for one in scores]} if scores else {}
