"""Archives: the runs of a lab as one Parquet data set, in a folder or an object store (docs/archive.md)."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass

from . import _arguments, _leafbench
from ._from_json import objects
from ._recording import Recording


@dataclass(frozen=True)
class ArchivedRun:
    """What an archive says about one run."""

    run_id: str
    #: Name or serial number of the spring.
    specimen: str
    #: Name of the bench.
    bench: str
    #: Empty if none was given.
    operator: str
    #: RFC 3339; empty if the run file had no time that could be read.
    started_utc: str
    #: Counted cycles that the run completed.
    cycles_completed: int


def archived_runs(place: str | os.PathLike[str]) -> tuple[ArchivedRun, ...]:
    """All runs of an archive, by start and then by id.

    Parameters
    ----------
    place
        Folder of the archive, or ``s3://BUCKET/PREFIX`` with the key in the environment (docs/archive.md).

    Raises
    ------
    InputError
        The place is no archive, or what it holds is damaged.
    OSError
        The place cannot be read.
    """
    return objects(ArchivedRun, json.loads(_leafbench.archived_runs(_arguments.path("place", place))))


def read_archive(place: str | os.PathLike[str], runs: str | ArchivedRun | Iterable[str | ArchivedRun]) -> list[Recording]:
    """Reads runs of an archive: the same numbers as those of their run files.

    Parameters
    ----------
    place
        As in :func:`archived_runs`.
    runs
        Run ids, or runs that :func:`archived_runs` has listed; one or several.

    Raises
    ------
    InputError
        There is no such run, or what the archive holds is damaged.
    OSError
        The place cannot be read.
    """
    given = [runs] if isinstance(runs, (str, ArchivedRun)) else runs
    if isinstance(given, Iterable) and not isinstance(given, bytes):
        # One by one: the first item that is no run is refused, before a list of all of them needs the memory.
        given = (run.run_id if isinstance(run, ArchivedRun) else run for run in _arguments.items("runs", given))
    read = _leafbench.read_archived(_arguments.path("place", place), _arguments.texts("runs", given))
    return [Recording._of(columns, specimen) for columns, specimen in read]
