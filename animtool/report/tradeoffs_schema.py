"""Models of the output of `animtool report --format json`, for its JSON Schema."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class _Model(BaseModel):
    """Base of models whose keys are all required."""

    model_config = ConfigDict(extra="forbid")


class DistancesModel(_Model):
    """Distances of points from their reference positions."""

    largest: float = Field(description="[m]")
    rms: float = Field(description="Root mean square [m].")
    median: float = Field(description="[m]")
    apart: float = Field(description="Fraction of points that only one of them has.")
    angle: float | None = Field(None, description="RMS of orientations [rad].")


class SettingModel(_Model):
    """One setting of a method that is measured."""

    method: str
    options: dict[str, float]


class ReferenceModel(SettingModel):
    """The reference that settings are compared with."""

    error: DistancesModel = Field(description="Uncertainty of the reference.")
    order: float | None = Field(
        description="Observed order of convergence in the step."
    )
    sensitive: bool = Field(
        description="Whether the motion does not converge at any step."
    )


class RowModel(SettingModel):
    """A setting and its measurements."""

    status: str = Field(description="Outcome: `ok`, `blew up`, `left out`, …")
    reason: str = Field(description="Why there is no error; empty if there is one.")
    stable_step: float | None = Field(description="The largest stable step [s].")
    seconds: float
    steps: int = Field(description="Work, in the unit of the table.")
    bytes: int = Field(description="Size of the output; 0 if none was written.")
    error: DistancesModel | None
    energy_drift: float | None = Field(description="Relative to the largest energy.")
    figures: dict[str, float] = Field(description="Strain, depth, misses by name.")
    worst: str = Field(description="Where the largest error is.")
    chosen: bool = Field(description="Whether this is the current setting.")
    best: bool = Field(description="Whether it is on the Pareto front.")
    recommended: bool


class TableModel(_Model):
    """The settings measured for one output."""

    name: str
    kind: str
    span: float = Field(description="Duration [s].")
    instants: int = Field(description="Number of times at which points were compared.")
    points: int
    extent: float = Field(description="Diagonal of the bounding box of the motion [m].")
    measure: Literal["largest", "rms"] = Field(
        description="The error that rows are ranked by."
    )
    cost: Literal["seconds", "bytes", "steps"]
    unit: str = Field(description="The unit of `steps`.")
    lines: list[str] = Field(description="How to select the recommended setting.")
    reference: ReferenceModel | None
    rows: list[RowModel]


class TradeoffsModel(_Model):
    """Output of `animtool report --format json`."""

    report: Literal["animtool/1"]
    source: str
    budget: float | None = Field(description="The error budget [m].")
    tables: list[TableModel]
    notices: list[dict[str, Any]]
