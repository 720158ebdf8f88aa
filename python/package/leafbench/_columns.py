"""Columns of numbers that other code made: checked, and as the bytes that the compiled half takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._errors import ArgumentTypeError, InputError, input_error

#: As many samples as the reader of CSV takes.
MOST_SAMPLES = 50_000_000
#: Type in memory of each column, in the order of a recording CSV.
TYPES: dict[str, type[np.number[Any]]] = {
    "time_s": np.float64,
    "displacement_mm": np.float64,
    "force_n": np.float64,
    "command_mm": np.float64,
    "command_n": np.float64,
    "cycle": np.uint32,
    "flags": np.uint16,
}
#: Largest value of each column of whole numbers.
LARGEST = {"cycle": 2**32 - 1, "flags": 2**16 - 1}
#: Columns that every recording has.
NEEDED = ("time_s", "displacement_mm", "force_n")


def column_of(name: str, column: str, values: object) -> NDArray[Any]:
    """The values as a contiguous array of the column's type. `name` is that of the recording."""
    array = _array(name, column, values)
    if column in LARGEST:
        array = _whole_numbers(name, column, array, LARGEST[column])
    return np.ascontiguousarray(array, dtype=TYPES[column])


def _array(name: str, column: str, values: object) -> NDArray[Any]:
    """One dimension, of integers or floating point numbers."""
    if isinstance(values, (str, bytes, dict, set)):
        raise ArgumentTypeError(f"{name}, column {column}: it is a {type(values).__name__}: give a list or an array of numbers")
    try:
        array = np.asarray(values)
    except (MemoryError, KeyboardInterrupt):
        raise
    except Exception as error:
        raise input_error(
            f"{name}, column {column}: it is no array of numbers ({error}): give a list or an array of numbers",
            file=name,
            column=column,
        ) from error
    if array.ndim != 1:
        raise input_error(
            f"{name}, column {column}: it has the shape {array.shape}: give one dimension, one value for each sample",
            file=name,
            column=column,
        )
    if array.size > MOST_SAMPLES:
        raise input_error(
            f"{name}, column {column}: it has {array.size} samples, and at most {MOST_SAMPLES} are taken: cut it or thin it out",
            file=name,
            column=column,
        )
    if array.dtype.kind == "O" and column.startswith("command"):
        array = np.array([np.nan if value is None else value for value in array])
    # An empty list is an array of floats.
    if array.dtype.kind not in "iuf":
        raise _no_numbers(name, column, array)
    return array


def _no_numbers(name: str, column: str, array: NDArray[Any]) -> InputError:
    """The error for values that are no real numbers, with the first of them."""
    index = None
    if array.dtype.kind == "O":
        wrong = (i for i, value in enumerate(array) if isinstance(value, bool) or not isinstance(value, (int, float)))
        index = next(wrong, None)
    where, what = ("", f"it has the type {array.dtype}") if index is None else (f", index {index}", f"{array[index]!r:.60}")
    what = what if index is None else f"{what} is no number"
    return input_error(
        f"{name}, column {column}{where}: {what}: give real numbers (int or float)", file=name, column=column, index=index
    )


def _whole_numbers(name: str, column: str, array: NDArray[Any], most: int) -> NDArray[Any]:
    """Refuses what a column of whole numbers cannot hold."""
    with np.errstate(invalid="ignore"):
        wrong = ~((array >= 0) & (array <= most) & (array == np.floor(array)))
    if wrong.any():
        index = int(np.argmax(wrong))
        raise input_error(
            f"{name}, column {column}, index {index}: {array[index]} is no whole number from 0 to {most}: correct it",
            file=name,
            column=column,
            index=index,
        )
    return array


def columns_of_table(table: Any) -> dict[str, object]:
    """The columns of a recording in a data frame (pandas, polars), an Arrow table or a dict; others are ignored."""
    # The columns of an Arrow table are arrays, and their names are elsewhere.
    given = table if isinstance(table, dict) else getattr(table, "column_names", getattr(table, "columns", None))
    if given is None or not hasattr(table, "__getitem__"):
        raise ArgumentTypeError(
            f"table is a {type(table).__name__}: give a data frame of pandas or polars, an Arrow table or a dict of columns"
        )
    names = list(given)
    missing = [column for column in NEEDED if column not in names]
    if missing:
        raise input_error(
            f"the table has no column {', '.join(missing)}: rename the column that has it; the columns are "
            f"{', '.join(map(str, names[:20])) or 'none'}",
            column=missing[0],
        )
    return {column: table[column] for column in TYPES if column in names}
