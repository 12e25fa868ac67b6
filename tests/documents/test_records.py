"""Models of files whose keys are fields of a record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import pytest
from pydantic import Field, ValidationError

from animtool.core.options import above, key, or_more, range_faults
from animtool.documents.check import FileModel
from animtool.documents.fields import record_from_model, with_fields


@dataclass(frozen=True)
class Cord:
    mass: Annotated[float, above(0, "SIM040")] = key("Mass [kg].", 0.5)
    slack: Annotated[float | None, or_more(1, "SIM042")] = key("Slack.", 2, None)
    kind: str = key("Kind.", "silk", "hemp", choices=("hemp", "silk"))


@with_fields(Cord, "kind", "mass", before_key="name")
class CordModel(FileModel):
    """A cord."""

    ends: list[int] = Field(description="Its ends.", examples=[[0, 1]])
    name: str = "cord"


@with_fields(Cord, "mass", "slack", range_check="schema")
class BoundedModel(FileModel):
    """A cord of sound numbers."""


def test_fields_are_keys_with_their_defaults_and_texts() -> None:
    fields = CordModel.model_fields
    assert list(fields) == ["ends", "kind", "mass", "name"]
    assert fields["mass"].is_required()
    assert fields["kind"].get_default() == "hemp"
    assert (fields["mass"].description, fields["mass"].examples) == (
        "Mass [kg].",
        [0.5],
    )
    assert (CordModel.__doc__, CordModel.__name__) == ("A cord.", "CordModel")


@pytest.mark.parametrize(
    ("model", "keys"),
    [
        (CordModel, {"ends": [], "mass": 1.0, "kind": "wire"}),
        (CordModel, {"ends": [], "mass": "1"}),
        (CordModel, {"ends": [], "mass": 1.0, "slack": 1.0}),
        (BoundedModel, {"mass": 0.0}),
        (BoundedModel, {"mass": 1.0, "slack": 0.5}),
        (BoundedModel, {"mass": 1e300}),
    ],
)
def test_what_is_no_value_of_a_field_is_refused(
    model: type[FileModel], keys: dict[str, object]
) -> None:
    with pytest.raises(ValidationError):
        model.model_validate(keys)


def test_ranges_are_left_to_who_reads_the_file_unless_asked_for() -> None:
    model = CordModel.model_validate({"ends": [], "mass": -1.0})
    assert dict(model) == {"ends": [], "kind": "hemp", "mass": -1.0, "name": "cord"}
    assert dict(BoundedModel.model_validate({"mass": 1.0})) == {
        "mass": 1.0,
        "slack": None,
    }


@with_fields(Cord, "slack")
class LongModel(BoundedModel):
    mass: float = Field(default=2.0, description="Its own.", examples=[3])


def test_keys_of_the_model_before_stay_and_own_ones_count() -> None:
    assert list(LongModel.model_fields) == ["mass", "slack"]
    assert LongModel.model_fields["mass"].description == "Its own."
    assert issubclass(LongModel, BoundedModel)


@dataclass(frozen=True, kw_only=True)
class Swing:
    angle: float = key("[deg]", 30, 0.0, read=math.radians)
    pushes: Sequence[tuple[float, int]] = key("Pushes.", [[0, 1]], ())
    end: Annotated[float, above(0, "SIM040")] = key("Never, not given.", 2, math.inf)
    length: float = 1.0


@with_fields(Swing, range_check="model")
class SwingModel(FileModel):
    pushes: list[list[float]] = Field(default=[[1.0, 2.0]], description="Its own.")


def test_all_that_have_keys_are_those_of_the_model_and_are_read() -> None:
    assert list(SwingModel.model_fields) == ["pushes", "angle", "end"]
    model = SwingModel.model_validate({"angle": 180})
    assert model.model_dump()["end"] is None
    pushes = [[1.0, 2.0]]
    assert record_from_model(Swing, model) == Swing(angle=math.pi, pushes=pushes)  # type: ignore[arg-type]
    given = record_from_model(Swing, SwingModel.model_validate({"end": 3}), length=2.0)
    assert (given.end, given.length) == (3, 2.0)


def test_ranges_of_a_model_are_those_of_the_record() -> None:
    wrong = SwingModel.model_validate({"end": -1})
    assert [fault.where for fault in range_faults(wrong)] == ["end"]
    assert range_faults(SwingModel()) == []
