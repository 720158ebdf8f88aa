"""What the commands of leafbench do, as functions."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, TypeAlias

from . import _arguments, _leafbench
from ._diagnosis import Diagnosis, diagnosis_of
from ._errors import ArgumentTypeError, InputError
from ._from_json import from_json
from ._recording import Recording, read
from ._results import Identification, Plan

PathLike: TypeAlias = "str | os.PathLike[str]"
#: One recording or several; a path is read.
Recordings: TypeAlias = "Recording | PathLike | Iterable[Recording | PathLike]"
#: Called with the share done, 0 to 1, and the current step. An exception in it ends the work and is raised again.
Progress: TypeAlias = "Callable[[float, str], Any]"

_MOST_THREADS = 256
_CONFIGS = str(_arguments.CONFIGS)


def _recordings(name: str, given: object, *, may_be_empty: bool = False) -> list[Recording]:
    """The recordings of an argument."""
    if isinstance(given, (Recording, str, os.PathLike)):
        given = [given]
    if isinstance(given, (Mapping, bytes)) or hasattr(given, "__arrow_c_stream__") or not isinstance(given, Iterable):
        raise ArgumentTypeError(_no_recording(name, given))
    found = []
    for index, item in enumerate(_arguments.items(name, given)):
        if isinstance(item, (str, os.PathLike)):
            item = read(item)
        if not isinstance(item, Recording):
            raise ArgumentTypeError(_no_recording(f"{name}[{index}]", item))
        found.append(item)
    if not found and not may_be_empty:
        raise InputError(f"{name} is empty: give at least one recording")
    return found


def _no_recording(name: str, given: object) -> str:
    kind = type(given).__name__
    if isinstance(given, Mapping) or hasattr(given, "columns") or hasattr(given, "__arrow_c_stream__"):
        return f"{name} is a {kind} and no recording: make one with leafbench.Recording.from_table(...)"
    return f"{name} is a {kind} and no recording: give recordings (leafbench.Recording) or paths of them"


def diagnose(
    recordings: Recordings,
    *,
    baseline: str | None = None,
    known: Iterable[str] | None = None,
    left_out: Recordings = (),
    bench: PathLike | None = None,
    mixed_specimens: bool = False,
    threads: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Says which physics a model lacks.

    Other threads go on while it works. Ctrl-C ends it.

    Parameters
    ----------
    recordings
        Recordings of one specimen on one rig, in mm and N, or their paths.
    baseline
        Name of the model to start from (:func:`models`); default: the model of the bench.
    known
        Codes of the physics that the baseline has already (:func:`physics`); ``[]`` for none. Default: what model and bench say.
    left_out
        Recordings that are only predicted: nothing is fitted to them and nothing chosen by them.
    bench
        Name of a shipped bench (:func:`benches`), path of a bench file, or its text; default: the mock rig. Its model, limits and
        known physics are used.
    mixed_specimens
        Takes recordings together that name different specimens.
    threads
        Threads that compute, 1 to 256; 0 for one on each core. The result is the same.
    progress
        Called on this thread with the share done, 0 to 1, and the current step.

    Raises
    ------
    InputError
        The recordings cannot be used, or a name is unknown.
    OSError
        A file cannot be read.
    KeyboardInterrupt
        Ctrl-C was pressed.
    """
    used = _recordings("recordings", recordings)
    predicted = _recordings("left_out", left_out, may_be_empty=True)
    if not _arguments.switch("mixed_specimens", mixed_specimens):
        _leafbench.require_one_specimen([(r.name, r.specimen) for r in (*used, *predicted)])
    json, improved_toml = _leafbench.diagnose(
        [r._columns for r in used],
        [r._columns for r in predicted],
        _arguments.text_or_none("baseline", baseline),
        None if known is None else _arguments.texts("known", known),
        _bench(bench),
        _CONFIGS,
        _arguments.whole("threads", threads, 0, _MOST_THREADS),
        _arguments.progress(progress),
    )
    return diagnosis_of(json, improved_toml)


def simulate(
    profile: PathLike, *, bench: PathLike | None = None, rig: bool = False, seed: int | None = None
) -> Recording:
    """Steps the bench's model along a profile at 1 kHz: no noise, no hydraulics, no limits.

    Parameters
    ----------
    profile
        Name of a shipped profile (:func:`profiles`), path of a profile file, or its text.
    bench
        Name of a shipped bench, path of a bench file, or its text; default: the mock rig.
    rig
        Runs the profile on the bench's mock rig in virtual time instead, with noise, hydraulics and limits.
    seed
        Seed of the sensor noise, 0 to 4294967295, with ``rig``; default: that of the bench.

    Raises
    ------
    InputError
        Profile or bench cannot be used, or the run on the mock rig did not complete.
    OSError
        A file cannot be read.
    """
    on_rig = _arguments.switch("rig", rig)
    if seed is not None:
        seed = _arguments.whole("seed", seed, 0, 2**32 - 1)
        if not on_rig:
            raise InputError("seed is for the noise of the mock rig: add rig=True, or leave seed out")
    columns, specimen = _leafbench.simulate(_profile(profile), _bench(bench), _CONFIGS, on_rig, seed)
    return Recording._of(columns, specimen)


def plan(profile: PathLike, *, bench: PathLike | None = None) -> Plan:
    """Predicts what a profile does, and compares it with the limits of the bench. Nothing moves.

    ``profile`` and ``bench`` are as in :func:`simulate`.
    """
    return from_json(Plan, _leafbench.plan(_profile(profile), _bench(bench), _CONFIGS))


def identify(
    recordings: Recordings,
    *,
    model: str | None = None,
    specimen: PathLike | None = None,
    method: Literal["least-squares", "nelder-mead", "differential-evolution"] = "least-squares",
    fix: Mapping[str, float] | None = None,
    free: Iterable[str] = (),
    begin: Literal["rest", "cycling", "unknown"] = "unknown",
    seed: int = 1,
    progress: Progress | None = None,
) -> Identification:
    """Fits the parameters of a model to recordings of one specimen.

    Parameters
    ----------
    recordings
        Recordings, or their paths; they are fitted together.
    model
        Name of the model (:func:`models`); may be left out where there is a ``specimen``.
    specimen
        Path of a specimen file to start from: model, values, geometry.
    method
        How to search.
    fix
        Parameters that are held, with their values in their unit.
    free
        The only parameters that are fitted; empty for all.
    begin
        State of the spring at the first sample: at ``rest``, in a steady cycle (``cycling``), or ``unknown``: the first half cycle is
        left out, unless the recording begins without load.
    seed
        Seed of the random draws, 0 to 2**64 - 1.
    progress
        As in :func:`diagnose`.

    Raises
    ------
    InputError
        The recordings cannot be used, or a name is unknown.
    OSError
        A file cannot be read.
    KeyboardInterrupt
        Ctrl-C was pressed.
    """
    used = _recordings("recordings", recordings)
    json, specimen_toml = _leafbench.identify(
        [r._columns for r in used],
        _arguments.text_or_none("model", model),
        None if specimen is None else _arguments.path("specimen", specimen),
        _arguments.text("method", method),
        [] if fix is None else _arguments.numbers_by_name("fix", fix),
        _arguments.texts("free", free),
        _arguments.text("begin", begin),
        _arguments.whole("seed", seed, 0, 2**64 - 1),
        _arguments.progress(progress),
    )
    return from_json(Identification, json, specimen_toml=specimen_toml)


def models() -> dict[str, str]:
    """Names of the models of a spring, each with what it is."""
    return dict(_leafbench.models())


def physics() -> list[str]:
    """Codes of the physics that a model may lack (docs/formats.md), sorted."""
    return _leafbench.physics()


def benches() -> list[str]:
    """Names of the benches that come with the package, sorted."""
    return _shipped("benches")


def profiles() -> list[str]:
    """Names of the profiles that come with the package, sorted."""
    return _shipped("profiles")


def bench_toml(bench: PathLike | None = None) -> str:
    """Text of a bench as one complete file that includes its specimen: to read, to change and to give as ``bench``.

    ``bench`` is as in :func:`simulate`.
    """
    return _leafbench.bench_toml(_bench(bench), _CONFIGS)


def _shipped(folder: str) -> list[str]:
    return sorted(path.stem for path in (_arguments.CONFIGS / folder).glob("*.toml"))


def _profile(given: object) -> str:
    return _arguments.word_or_path("profile", given)


def _bench(given: object) -> str | None:
    return None if given is None else _arguments.word_or_path("bench", given)
