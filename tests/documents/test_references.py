from __future__ import annotations

from pathlib import Path

import pytest

from animtool.documents.references import reference


def test_references_stay_in_the_roots(tmp_path: Path) -> None:
    folder, library = tmp_path / "a", tmp_path / "library"
    folder.mkdir()
    assert reference(folder, [tmp_path], "../x.npz") == tmp_path / "x.npz"
    assert reference(folder, [folder, library], "../library/x") == library / "x"
    (folder / "way").symlink_to(tmp_path)
    for name in ("../x.npz", "/etc/passwd", "b/../../x", "way/x.npz", "../ab/x"):
        with pytest.raises(ValueError, match="leads out"):
            reference(folder, [folder], name)
