"""Recordings: samples of one run of one spring, in columns."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _arguments
from ._columns import column_of, columns_of_table
from ._errors import ArgumentTypeError, InputError, input_error
from ._leafbench import Column, Columns
from ._leafbench import read as _read

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Recording", "read"]


class Recording:
    """Samples of one run: time, displacement and force, and what else was recorded.

    A recording does not change. Its arrays are views of its memory, read-only, and Arrow, polars and pandas read the same memory.

    Parameters
    ----------
    time_s
        Time in s, strictly rising.
    displacement_mm
        Displacement of the specimen in mm; loading is positive.
    force_n
        Force on the specimen in N; loading is positive.
    command_mm, command_n
        Commanded displacement in mm or force in N; NaN where there was none. At most one of the two.
    cycle
        Counted cycle from 1; 0 outside the counted cycles.
    flags
        Quality of the sample: 0 is good, else a sum of the bits in docs/formats.md.
    name
        File name or run id; errors and results name the recording by it.
    specimen
        Name or serial number of the spring, or None.

    Raises
    ------
    InputError
        Columns of different length, values that are not finite, or time that does not rise. ``column`` and ``index`` have the place.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(0, 10, 0.01)
    >>> x = 5 - 5 * np.cos(t)
    >>> Recording(t, x, 80 * x, name="linear")
    Recording('linear', 1000 samples, 9.99 s, columns time_s, displacement_mm, force_n)
    """

    __slots__ = ("_columns", "_notes", "_specimen")

    def __init__(
        self,
        time_s: ArrayLike,
        displacement_mm: ArrayLike,
        force_n: ArrayLike,
        *,
        command_mm: ArrayLike | None = None,
        command_n: ArrayLike | None = None,
        cycle: ArrayLike | None = None,
        flags: ArrayLike | None = None,
        name: str = "recording",
        specimen: str | None = None,
    ) -> None:
        name = _arguments.text("name", name)
        if command_mm is not None and command_n is not None:
            raise input_error(
                f"{name}: command_mm and command_n are both given: give the one that the rig controlled",
                file=name,
                column="command_n",
            )
        given = {
            "time_s": time_s,
            "displacement_mm": displacement_mm,
            "force_n": force_n,
            "command_mm": command_mm,
            "command_n": command_n,
            "cycle": cycle,
            "flags": flags,
        }
        needed = ("time_s", "displacement_mm", "force_n")
        columns = {
            column: column_of(name, column, values).tobytes()
            for column, values in given.items()
            if values is not None or column in needed
        }
        self._columns = Columns(name, **columns)
        self._specimen = _arguments.text_or_none("specimen", specimen)
        self._notes: tuple[str, ...] = ()

    @classmethod
    def _of(cls, columns: Columns, specimen: str | None, notes: tuple[str, ...] = ()) -> Recording:
        """A recording around columns that are checked already."""
        recording = cls.__new__(cls)
        recording._columns, recording._specimen, recording._notes = columns, specimen, notes
        return recording

    @classmethod
    def from_table(cls, table: Any, *, name: str = "table", specimen: str | None = None) -> Recording:
        """A recording from a data frame (pandas, polars), an Arrow table or a dict.

        The columns have the names of a recording CSV; columns of other names are ignored.
        """
        columns = columns_of_table(table)
        if "command_mm" in columns and "command_n" in columns:
            # As the reader of CSV does: the mode of the first command is that of the recording.
            columns.pop(_other_command(name, columns))
        return cls(**columns, name=name, specimen=specimen)  # type: ignore[arg-type]

    @property
    def name(self) -> str:
        """File name or run id."""
        return self._columns.name

    @property
    def specimen(self) -> str | None:
        """Name or serial number of the spring; None if the file does not say."""
        return self._specimen

    @property
    def notes(self) -> tuple[str, ...]:
        """What is not whole about the file, one sentence each; empty for a sound one."""
        return self._notes

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that are there."""
        return tuple(self._columns.names())

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time in s."""
        return self["time_s"]

    @property
    def displacement_mm(self) -> NDArray[np.float64]:
        """Displacement of the specimen in mm."""
        return self["displacement_mm"]

    @property
    def force_n(self) -> NDArray[np.float64]:
        """Force on the specimen in N."""
        return self["force_n"]

    @property
    def command_mm(self) -> NDArray[np.float64] | None:
        """Commanded displacement in mm, NaN where there was none; None in force control."""
        return self._optional("command_mm")

    @property
    def command_n(self) -> NDArray[np.float64] | None:
        """Commanded force in N, NaN where there was none; None in displacement control."""
        return self._optional("command_n")

    @property
    def cycle(self) -> NDArray[np.uint32] | None:
        """Counted cycle from 1; 0 outside the counted cycles."""
        return self._optional("cycle")

    @property
    def flags(self) -> NDArray[np.uint16] | None:
        """Quality of each sample; 0 is good."""
        return self._optional("flags")

    def _optional(self, column: str) -> NDArray[Any] | None:
        return self[column] if column in self._columns.names() else None

    def __getitem__(self, column: str) -> NDArray[Any]:
        """A column as a numpy array: read-only, a view of the recording's memory. KeyError if it is not there."""
        return np.asarray(self._column(column))

    def _column(self, column: str) -> Column:
        if not isinstance(column, str):
            raise ArgumentTypeError(f"a column is named by a text, not by a {type(column).__name__}: use one of {self.columns}")
        return self._columns[column]

    def __len__(self) -> int:
        """Number of samples."""
        return len(self._columns)

    def __repr__(self) -> str:
        time_s = self.time_s
        return (
            f"Recording({self.name!r}, {len(self)} samples, {time_s[-1] - time_s[0]:.6g} s, columns {', '.join(self.columns)})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        arrays = {column: np.array(self[column]) for column in self.columns}
        return _restored, (arrays, self.name, self._specimen, self._notes)

    def flipped(self, *, force: bool = False, displacement: bool = False) -> Recording:
        """A copy with the sign of the force, of the displacement or of both turned."""
        columns = self._columns.flipped(_arguments.switch("force", force), _arguments.switch("displacement", displacement))
        return Recording._of(columns, self._specimen, self._notes)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """The recording as an Arrow stream of one batch, without a copy (Arrow PyCapsule interface)."""
        return self._columns.__arrow_c_stream__(requested_schema)

    def __arrow_c_schema__(self) -> object:
        """The schema of the stream; the metadata of each field has its ``unit``."""
        return self._columns.__arrow_c_schema__()

    def to_arrow(self) -> pyarrow.Table:
        """An Arrow table over the recording's memory. Needs pyarrow."""
        import pyarrow

        return pyarrow.table(self)

    def to_polars(self) -> polars.DataFrame:
        """A data frame of polars over the recording's memory. Needs polars."""
        import polars

        return polars.DataFrame(self)

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame of pandas over the recording's memory, each column by itself. Needs pandas."""
        import pandas

        return pandas.DataFrame({column: self[column] for column in self.columns}, copy=False)


def _other_command(name: str, columns: dict[str, object]) -> str:
    """Of two columns of commands, the one whose first command comes later."""
    first = {}
    for column in ("command_mm", "command_n"):
        there = ~np.isnan(column_of(name, column, columns[column]))
        first[column] = int(np.argmax(there)) if there.any() else len(there)
    return "command_mm" if first["command_n"] < first["command_mm"] else "command_n"


def _restored(
    arrays: dict[str, Any], name: str, specimen: str | None, notes: tuple[str, ...]
) -> Recording:
    """A recording from what pickle kept."""
    recording = Recording(**arrays, name=name, specimen=specimen)
    recording._notes = notes
    return recording


def read(path: str | os.PathLike[str]) -> Recording:
    """Reads a run file (``.leafrun``) or, with any other name, a recording CSV.

    The specimen is taken from the run file, or from the data package beside the CSV.

    Raises
    ------
    InputError
        The file is no recording. ``file``, ``row`` (the header of a CSV is row 1) and ``column`` have the place.
    OSError
        The file cannot be read: FileNotFoundError, PermissionError and so on.
    """
    given = _arguments.path("path", path)
    if Path(given).is_dir():
        raise InputError(f"{given} is a folder: give a run file (.leafrun) or a CSV; leafbench.read_archive reads an archive")
    columns, specimen, notes = _read(given)
    return Recording._of(columns, specimen, tuple(notes))
