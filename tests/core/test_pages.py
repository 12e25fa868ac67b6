"""Pages of the documentation: their kinds, and how topics find them."""

from __future__ import annotations

import pytest

from animtool.core.errors import OptionError
from animtool.core.pages import (
    PAGE_BY_SUBJECT,
    PAGE_KINDS,
    all_pages,
    find_page,
    page_markdown,
)


def test_pages_are_sorted_by_kind_and_titled_by_their_heading() -> None:
    pages = all_pages()
    kinds = [list(PAGE_KINDS.values()).index(page.kind) for page in pages]
    assert kinds == sorted(kinds)
    assert set(kinds) == set(range(len(PAGE_KINDS)))
    for page in pages:
        assert page_markdown(page).startswith(f"# {page.title}\n")
        assert page.title


def test_the_last_part_of_a_name_is_enough() -> None:
    names = [page.name for page in all_pages()]
    assert len({name.split("/")[-1] for name in names}) == len(names)
    assert all(find_page(name.split("/")[-1]).name == name for name in names)


@pytest.mark.parametrize("topic", ["", "  ", "/", "no such page", "../README"])
def test_no_page_has_that_name(topic: str) -> None:
    with pytest.raises(OptionError) as caught:
        find_page(topic)
    assert [fault.code for fault in caught.value.faults] == ["CLI009"]


def test_a_word_of_a_heading_leads_to_its_page() -> None:
    assert find_page("slurm").name == "howto/farm"
    assert find_page("root_motion").name == "reference/passes"
    with pytest.raises(OptionError) as caught:
        find_page("mirror")  # a pass, and a key of rigs
    hint = str(caught.value.faults[0].hint)
    assert "reference/passes" in hint
    assert "reference/rig-files" in hint


def test_words_of_users_lead_to_pages() -> None:
    names = {page.name for page in all_pages()}
    assert set(PAGE_BY_SUBJECT.values()) <= names
    assert find_page("Mixamo").name == "howto/fbx-and-gltf"


def test_a_mistyped_name_is_corrected() -> None:
    with pytest.raises(OptionError) as caught:
        find_page("desk-lmap")
    assert "'desk-lamp'" in str(caught.value.faults[0].hint)
