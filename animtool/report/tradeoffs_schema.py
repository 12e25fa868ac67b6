"""What `animtool report --format json` prints, as models for its JSON Schema."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class _Model(BaseModel):
    """Keys that are all there."""

    model_config = ConfigDict(extra="forbid")


class DistancesModel(_Model):
    """How far points are from where the reference has them."""

    largest: float = Field(description="[m]")
    rms: float = Field(description="Root of the mean of squares [m].")
    median: float = Field(description="[m]")
    apart: float = Field(description="Share of the points that only one has.")
    angle: float | None = Field(None, description="Of orientations, rms [rad].")


class SettingModel(_Model):
    """A way to make something."""

    method: str
    options: dict[str, float]


class ReferenceModel(SettingModel):
    """What settings are compared with."""

    error: DistancesModel = Field(description="How far it may be off itself.")
    order: float | None = Field(description="Power of the step that errors go with.")
    sensitive: bool = Field(description="Whether no step brings the motion near.")


class RowModel(SettingModel):
    """A setting, and what it comes to."""

    status: str = Field(description="How it ended: `ok`, `blew up`, `left out`, …")
    reason: str = Field(description="Why it has no error; empty where it has one.")
    stable_step: float | None = Field(description="The largest that is stable [s].")
    seconds: float
    steps: int = Field(description="Work that was counted, in the unit of the table.")
    bytes: int = Field(description="Size of what was written; 0 where nothing was.")
    error: DistancesModel | None
    energy_drift: float | None = Field(description="Share of the largest energy.")
    figures: dict[str, float] = Field(description="Stretch, depth, misses by name.")
    worst: str = Field(description="Where the largest distance is.")
    chosen: bool = Field(description="Whether it is the current setting.")
    best: bool = Field(description="Whether no other that is as exact is cheaper.")
    recommended: bool


class TableModel(_Model):
    """The settings of one thing that is made."""

    name: str
    kind: str
    span: float = Field(description="How long it is [s].")
    instants: int = Field(description="At how many times points were compared.")
    points: int
    extent: float = Field(description="Diagonal of the box that they stay in [m].")
    measure: Literal["largest", "rms"] = Field(description="What rows are judged by.")
    cost: Literal["seconds", "bytes", "steps"]
    unit: str = Field(description="What `steps` count.")
    lines: list[str] = Field(description="How the recommended setting is asked for.")
    reference: ReferenceModel | None
    rows: list[RowModel]


class TradeoffsModel(_Model):
    """What `animtool report --format json` prints."""

    report: Literal["animtool/1"]
    source: str
    budget: float | None = Field(description="The error that will do [m].")
    tables: list[TableModel]
    notices: list[dict[str, Any]]
