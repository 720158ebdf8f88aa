"""The compiled half. Use the functions of ``leafbench``, which check their arguments."""

from collections.abc import Callable
from typing import Any

__version__: str

class InputError(ValueError):
    """Input that cannot be used. The text says what is wrong, where, and what to do."""

    file: str | None
    row: int | None
    column: str | None
    index: int | None

class InternalError(RuntimeError):
    """A defect of leafbench. Please report it, with the text."""

class Column:
    """One column of a recording."""

    def __len__(self) -> int: ...
    @property
    def __array_interface__(self) -> dict[str, Any]: ...
    def __arrow_c_array__(self, requested_schema: object = None) -> tuple[object, object]: ...

class Columns:
    """The columns of a recording."""

    def __init__(
        self,
        name: str,
        time_s: bytes,
        displacement_mm: bytes,
        force_n: bytes,
        command_mm: bytes | None = None,
        command_n: bytes | None = None,
        cycle: bytes | None = None,
        flags: bytes | None = None,
    ) -> None: ...
    @property
    def name(self) -> str: ...
    def names(self) -> list[str]: ...
    def flipped(self, force: bool, displacement: bool) -> Columns: ...
    def __getitem__(self, name: str) -> Column: ...
    def __len__(self) -> int: ...
    def __arrow_c_stream__(self, requested_schema: object = None) -> object: ...
    def __arrow_c_schema__(self) -> object: ...

_Progress = Callable[[float, str], Any] | None

def read(path: str) -> tuple[Columns, str | None, list[str]]: ...
def archived_runs(place: str) -> str: ...
def read_archived(place: str, run_ids: list[str]) -> list[tuple[Columns, str | None]]: ...
def undiagnosed_runs(place: str, baseline: str) -> list[str]: ...
def diagnose_archived(place: str, run_id: str, baseline: str, estimates_only: bool) -> str: ...
def store_diagnoses(place: str, diagnosed: list[str]) -> int: ...
def simulate(profile: str, bench: str | None, configs: str, rig: bool, seed: int | None) -> tuple[Columns, str]: ...
def plan(profile: str, bench: str | None, configs: str) -> str: ...
def identify(
    recordings: list[Columns],
    model: str | None,
    specimen: str | None,
    method: str,
    fix: list[tuple[str, float]],
    free: list[str],
    begin: str,
    seed: int,
    progress: _Progress,
) -> tuple[str, str]: ...
def diagnose(
    recordings: list[Columns],
    left_out: list[Columns],
    baseline: str | None,
    known: list[str] | None,
    bench: str | None,
    configs: str,
    threads: int,
    progress: _Progress,
) -> tuple[str, str | None]: ...
def require_one_specimen(recordings: list[tuple[str, str | None]]) -> None: ...
def bench_toml(bench: str | None, configs: str) -> str: ...
def models() -> list[tuple[str, str]]: ...
def physics() -> list[str]: ...
