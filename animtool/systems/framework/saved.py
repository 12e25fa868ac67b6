"""Saved simulation states in npz files, to resume from."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import Field, field, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import numpy.typing as npt

from animtool.core.errors import Fault, FormatError, OptionError, listed
from animtool.core.files.commit import output_error
from animtool.core.files.output import replacement_path
from animtool.core.record import dataclass
from animtool.documents.arrays import Archives
from animtool.systems.framework.run import ReachedState

STATE_FORMAT = "animtool-system/1"
# Largest integer that is exact as a float.
MAX_EXACT_INTEGER = 2**53
# Largest number in a state, whose square fits into float64.
MAX_MAGNITUDE = 1e150
_Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True)
class StateClock:
    """Kind, start and step of a saved state, to compare with those of the scene."""

    kind: str  # kind of system or attachment
    begin: float  # time of the first step [s]; for an attachment the frame
    step: float  # step length [s]; for an attachment one frame


def write_states(
    path: Path, states: Mapping[str, tuple[StateClock, ReachedState[Any]]]
) -> None:
    """Write states by name, replacing the file; a single state has no name."""
    arrays: _Arrays = {"format": np.array(STATE_FORMAT)}
    for name, (clock, reached_state) in states.items():
        prefix = f"{name}/" if name else ""
        clock_row = [clock.begin, clock.step, float(reached_state.step_count)]
        state = _state_arrays(reached_state.state)
        arrays[f"{prefix}kind"] = np.array(clock.kind)
        arrays[f"{prefix}clock"] = np.array(clock_row)
        arrays[f"{prefix}state"] = np.array(_names_text(state))
        arrays |= {f"{prefix}state/{key}": rows for key, rows in state.items()}
    try:
        with (
            replacement_path(path) as temporary_path,
            temporary_path.open("wb") as file,
        ):
            np.savez(file, **arrays)  # type: ignore[arg-type]
    except OSError as error:
        raise output_error(path, error) from error


@contextmanager
def open_states(path: Path) -> Iterator[SavedStates]:
    """Open a file of states as a context manager."""
    try:
        with Archives() as archives:
            has_format = archives.has(path, "format")
            if not has_format or archives.text(path, "format") != STATE_FORMAT:
                message = "is not a file of saved states"
                raise FormatError(Fault("SIM035", message, str(path)))
            yield SavedStates(archives, path)
    except ValueError as error:
        raise FormatError(Fault("SIM035", f"{error}", str(path))) from error


@dataclass(frozen=True, slots=True)
class SavedStates:
    """The states of an open file."""

    archives: Archives
    path: Path

    @property
    def names(self) -> list[str]:
        """Names of the saved states; a single state has an empty name."""
        names = [name.rpartition("/") for name in self.archives.names(self.path)]
        return [prefix for prefix, _, key in names if key == "clock"]

    def _mismatch(
        self, name: str, message: str, hint: str | None = None
    ) -> OptionError:
        text = f"{name}: {message}" if name else message
        return OptionError(Fault("SIM035", text, str(self.path), (), hint))

    def clock(self, name: str, expected_kind: str) -> tuple[StateClock, int]:
        """Return the clock of a saved state of a kind, and its number of steps."""
        archives, path = self.archives, self.path
        prefix = f"{name}/" if name else ""
        if name and not archives.has(path, f"{prefix}kind"):
            raise self._mismatch(name, "the state does not exist")
        kind = archives.text(path, f"{prefix}kind")
        if kind != expected_kind:
            message = f"the state is of a system of {kind}, not of {expected_kind}"
            hint = f"name a file that a system of {expected_kind} saves"
            raise self._mismatch(name, message, hint)
        clock_row = archives.load(path, f"{prefix}clock")
        if (
            clock_row.shape != (3,)
            or not 0 <= clock_row[2] <= MAX_EXACT_INTEGER
            or clock_row[2] % 1
        ):
            message = "its clock is not a start, a step and a count"
            raise self._mismatch(name, message)
        begin, step, count = clock_row.tolist()
        return StateClock(kind, begin, step), int(count)

    def read(
        self, name: str, expected_clock: StateClock, initial_state: ReachedState[Any]
    ) -> ReachedState[Any]:
        """Return a saved state that has the structure of an initial state."""
        archives, path = self.archives, self.path
        prefix = f"{name}/" if name else ""
        mismatch = partial(self._mismatch, name)
        saved_clock, step_count = self.clock(name, expected_clock.kind)
        clock_problem = _clock_problem(saved_clock, expected_clock)
        if clock_problem:
            raise mismatch(*clock_problem)
        expected_arrays, metadata = _state_arrays(initial_state.state), _FieldMetadata()
        _collect_metadata(initial_state.state, metadata)
        saved_names = archives.text(path, f"{prefix}state")
        names_in_file = set(saved_names.split(", "))
        missing_names = metadata.added_names - names_in_file
        names = sorted(
            (expected_arrays.keys() - missing_names)
            | {n for n in names_in_file if metadata.starts_as_none(n)}
        )
        if saved_names != _names_text(names):
            expected_names = _names_text(expected_arrays)
            message = f"its state has {saved_names}, but the scene's {expected_names}"
            raise mismatch(message)
        arrays: _Arrays = {}
        lengths = set()
        for key in names:
            saved_array = arrays[key] = archives.load_stored(
                path, f"{prefix}state/{key}"
            )
            expected_array = expected_arrays.get(key, saved_array)
            axis = metadata.growing_axes.get(key)
            problem = _array_problem(saved_array, expected_array, axis)
            if problem:
                raise mismatch(f"{key} {problem}")
            if axis is not None:
                lengths.add(saved_array.shape[axis])
            arrays[key] = saved_array.astype(expected_array.dtype)
        if len(lengths) > 1:
            counts = listed(sorted(lengths))
            raise mismatch(f"its arrays have {counts} rows; they must be equal")
        try:
            arrays |= {key: expected_arrays[key] for key in missing_names}
            state = _restore(initial_state.state, arrays, metadata)
            return ReachedState(step_count, state)
        except TypeError as error:
            raise mismatch(f"its state has {saved_names}: {error}") from error


def _clock_problem(
    saved_clock: StateClock, expected_clock: StateClock
) -> Sequence[str]:
    """Return why a saved clock does not match, and a hint; empty if it does."""
    begin, step = saved_clock.begin, saved_clock.step
    if math.isclose(begin, expected_clock.begin) and math.isclose(
        step, expected_clock.step
    ):
        return ()
    message = f"its steps of {step:g} s start at {begin:g} s, but those of the scene, "
    message += f"of {expected_clock.step:g} s, start at {expected_clock.begin:g} s"
    return [message, "keep the step and the pre-roll it was saved with"]


def _array_problem(
    saved_array: npt.NDArray[Any], expected_array: npt.NDArray[Any], axis: int | None
) -> str:
    """Return why a saved array is invalid; empty if it is not.

    Its length may differ from that of the expected array along ``axis``.
    """
    shape = list(expected_array.shape)
    if axis is not None and saved_array.ndim == expected_array.ndim:
        shape[axis] = saved_array.shape[axis]
    if (
        saved_array.shape != (*shape,)
        or saved_array.dtype.kind != expected_array.dtype.kind
    ):
        if saved_array.dtype.kind == expected_array.dtype.kind:
            text = f"has shape {saved_array.shape}, but the scene needs {(*shape,)}: "
            return f"{text}it was saved with other counts"
        text = f"is {saved_array.dtype} of shape {saved_array.shape}, but in the scene "
        return f"{text}{expected_array.dtype} of shape {expected_array.shape}"
    # Particles without a lifetime have an infinite time of death.
    is_valid = np.isfinite(saved_array) if axis is None else ~np.isnan(saved_array)
    if expected_array.dtype.kind == "f" and not is_valid.all():
        return "contains a number that is not finite"
    if not _is_in_bounds(saved_array, expected_array):
        return "contains a number that is out of bounds"
    return ""


def _is_in_bounds(saved_array: npt.NDArray[Any], template: npt.NDArray[Any]) -> bool:
    """Return whether saved numbers are in bounds; a count may be -1 if missing."""
    if template.dtype.kind == "f":
        # The precision of a file may differ from that of a state.
        with np.errstate(over="ignore"):
            magnitudes = np.abs(
                saved_array[np.isfinite(saved_array)].astype(np.float64)
            )
        return bool(magnitudes.max(initial=0.0) <= MAX_MAGNITUDE)
    if template.ndim or template.dtype.kind not in "iu":
        return True
    return -1 <= int(saved_array) <= MAX_EXACT_INTEGER


@dataclass(frozen=True, slots=True)
class _FieldMetadata:
    """Metadata of state fields, by the name of the field."""

    growing_axes: dict[str, int] = field(default_factory=dict)  # of `growing_field`
    # Types of each `field_set_later`.
    later_types: dict[str, tuple[type[Any], ...]] = field(default_factory=dict)
    added_names: set[str] = field(default_factory=set)  # of `field_added_later`

    def starts_as_none(self, name: str) -> bool:
        """Return whether an array belongs to a field that starts as None."""
        return any(f"{name}.".startswith(f"{prefix}.") for prefix in self.later_types)


def _collect_metadata(
    state: Any, metadata: _FieldMetadata, prefix: str = "", axis: int | None = None
) -> None:
    """Collect the metadata of a state's fields, nested records included."""
    if axis is not None:
        metadata.growing_axes[prefix] = axis
    state_fields = fields(state) if is_dataclass(state) else ()
    for state_field in state_fields:
        saved_name = _saved_name(state_field)
        name = f"{prefix}.{saved_name}" if prefix else saved_name
        if "later" in state_field.metadata:
            metadata.later_types[name] = state_field.metadata["later"]
        if "added" in state_field.metadata:
            metadata.added_names.add(name)
        grow_axis = state_field.metadata.get("grows", axis)
        _collect_metadata(getattr(state, state_field.name), metadata, name, grow_axis)


def _names_text(names: Collection[str]) -> str:
    return ", ".join(sorted(names)) or "nothing"


def _state_arrays(state: Any, prefix: str = "") -> _Arrays:
    """Return the arrays and numbers of a state by name; None values are left out."""
    if state is None:
        return {}
    if not (isinstance(state, Mapping) or is_dataclass(state)):
        array = np.asarray(state)
        if array.dtype.kind not in "iufb":
            message = f"{prefix} of a state is not an array of numbers: {state!r}"
            raise TypeError(message)
        return {prefix: array}
    arrays: _Arrays = {}
    for saved_name, _, value in _items_of(state):
        name = f"{prefix}.{saved_name}" if prefix else saved_name
        arrays |= _state_arrays(value, name)
    return arrays


def _items_of(state: Any) -> Iterator[tuple[str, str, Any]]:
    """Yield saved name, name and value of each field of a record or mapping."""
    if isinstance(state, Mapping):
        for name, value in state.items():
            yield name, name, value
    else:
        for state_field in fields(state):
            name = state_field.name
            yield _saved_name(state_field), name, getattr(state, name)


def _saved_name(state_field: Field[Any]) -> str:
    return str(state_field.metadata.get("saved_name", state_field.name))


def _restore(
    template: Any, arrays: _Arrays, metadata: _FieldMetadata, prefix: str = ""
) -> Any:
    """Restore a state with the structure of a template from arrays by name."""
    if prefix in metadata.later_types:
        return _restore_unset_field(arrays, metadata.later_types[prefix], prefix)
    if template is None:
        return None
    if isinstance(template, Mapping) or is_dataclass(template):
        parent = f"{prefix}." if prefix else ""
        values = {
            name: _restore(value, arrays, metadata, f"{parent}{saved_name}")
            for saved_name, name, value in _items_of(template)
        }
        return replace(template, **values) if is_dataclass(template) else values  # type: ignore[type-var]
    array = arrays[prefix]
    return array if isinstance(template, np.ndarray) else type(template)(array.item())


def _restore_unset_field(
    arrays: _Arrays, record_types: Sequence[type[Any]], prefix: str
) -> Any:
    """Return the value of a field that starts as None; None if no array was saved."""
    values_by_name = {
        name.removeprefix(f"{prefix}."): values if values.ndim else values.item()
        for name, values in arrays.items()
        if name == prefix or name.startswith(f"{prefix}.")
    }
    if not values_by_name:
        return None
    (value, *others) = values_by_name.values()
    is_value = prefix in values_by_name and not others
    if is_value and type(value) in (record_types or (float,)):
        return value
    for record in record_types:
        if record is np.ndarray:
            continue
        hints = get_type_hints(record)
        expected_types = {
            name: float if hint is float else np.ndarray for name, hint in hints.items()
        }
        if {
            name: type(entry) for name, entry in values_by_name.items()
        } == expected_types:
            return record(**values_by_name)
    raise TypeError(f"{prefix} belongs to another method")
