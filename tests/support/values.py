"""Plain values as files hold them, drawn for tests."""

from __future__ import annotations

from hypothesis import strategies as st

__all__ = ["VALUES"]

TEXT = st.text(
    st.characters(exclude_categories=["Cc", "Cs"]), max_size=8
) | st.sampled_from(["1e3", "0o17", "no", "~", ".nan", "", "0x1", "12:30", "null", "-"])
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats(allow_nan=False)
    | TEXT
)
# Mappings of anything that YAML and JSON have.
VALUES = st.dictionaries(
    TEXT,
    st.recursive(
        LEAVES,
        lambda inner: (
            st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4)
        ),
        max_leaves=16,
    ),
    min_size=1,
    max_size=4,
)
