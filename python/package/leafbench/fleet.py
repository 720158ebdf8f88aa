"""Diagnoses the runs of an archive, on the cores of one machine or on the workers of a Ray cluster.

::

    python -m leafbench.fleet diagnose lab-archive
    python -m leafbench.fleet diagnose s3://lab/leafbench --engine ray --address auto

Whatever the engine and the number of workers, the archive gets the same table of diagnoses (docs/archive.md), each run once: the same bytes
from the same version of this package. Only this
process writes; it commits every few runs, so it may be killed and given again. ``leafbench fleet report`` pools the table.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from itertools import islice

from . import _arguments, _leafbench
from ._errors import ArgumentTypeError, InputError

#: Diagnoses are committed when there are so many, or after so many seconds: what a kill loses.
RUNS_OF_A_COMMIT, SECONDS_OF_A_COMMIT = 32, 10.0
#: Runs that are handed out for each worker: while one is diagnosed the next one waits.
RUNS_AHEAD = 2
#: How often a run is given to another worker after its worker was lost.
RETRIES = 10

ENGINES = ("local", "ray")
Progress = Callable[[int, int], None]


def diagnose(
    archive: str | os.PathLike[str],
    *,
    engine: str = "local",
    workers: int = 0,
    baseline: str = "equivalent",
    estimates_only: bool = False,
    address: str | None = None,
    progress: Progress | None = None,
) -> int:
    """Diagnoses the runs of an archive that have no diagnosis with this model yet. Returns how many there were.

    Parameters
    ----------
    archive
        Folder of the archive, or ``s3://BUCKET/PREFIX``. Every worker must reach it under this name.
    engine
        ``"local"``: threads of this process, which compute without the interpreter's lock. ``"ray"``: workers of Ray.
    workers
        How many runs are diagnosed at once; 0 for one on each core.
    baseline
        Model that each diagnosis begins with.
    estimates_only
        Without the search for missing effects in each run alone. Pooling needs only the estimates.
    address
        Address of a Ray cluster, such as ``"auto"``; without one, Ray starts on this machine.
    progress
        Called with the number of runs that are done and the number of all that were to do.

    Raises
    ------
    InputError
        There is no such archive or model, or what the archive holds is damaged.
    OSError
        The archive cannot be read or written.
    ImportError
        The engine is ``"ray"`` and the package ray is not installed.
    """
    place = _arguments.path("archive", archive)
    model = _arguments.text("baseline", baseline)
    if _arguments.text("engine", engine) not in ENGINES:
        raise InputError(f'engine is {engine!r}: give "local" or "ray"')
    count = _arguments.whole("workers", workers, 0, 10_000) or os.cpu_count() or 1
    only_estimates = _arguments.switch("estimates_only", estimates_only)
    cluster = _arguments.text_or_none("address", address)
    if progress is not None and not callable(progress):
        raise ArgumentTypeError(f"progress is a {type(progress).__name__}: give a function of two arguments, done and to do (int)")
    runs = _leafbench.undiagnosed_runs(place, model)
    if not runs:
        return 0
    if engine == "ray":
        found = _on_ray(place, runs, model, only_estimates, count, cluster)
    else:
        found = _on_threads(place, runs, model, only_estimates, count)
    waiting: list[str] = []
    committed_at = time.monotonic()
    done = 0
    for diagnosed in found:
        waiting.append(diagnosed)
        done += 1
        if len(waiting) >= RUNS_OF_A_COMMIT or time.monotonic() - committed_at > SECONDS_OF_A_COMMIT:
            _leafbench.store_diagnoses(place, waiting)
            waiting, committed_at = [], time.monotonic()
        if progress is not None:
            progress(done, len(runs))
    if waiting:
        _leafbench.store_diagnoses(place, waiting)
    return done


def _on_threads(place: str, runs: list[str], model: str, estimates_only: bool, workers: int) -> Iterator[str]:
    """The diagnosis of each run, in the order in which they are ready."""
    with ThreadPoolExecutor(workers, thread_name_prefix="diagnose") as pool:
        left = iter(runs)
        running = {pool.submit(_leafbench.diagnose_archived, place, run, model, estimates_only)
                   for run in islice(left, RUNS_AHEAD * workers)}
        try:
            while running:
                ready, running = wait(running, return_when=FIRST_COMPLETED)
                for run in islice(left, len(ready)):
                    running.add(pool.submit(_leafbench.diagnose_archived, place, run, model, estimates_only))
                for future in ready:
                    yield future.result()
        finally:
            for future in running:
                future.cancel()


def _on_ray(
    place: str, runs: list[str], model: str, estimates_only: bool, workers: int, address: str | None
) -> Iterator[str]:
    """The same on Ray. A run whose worker is lost goes to another one."""
    try:
        import ray
    except ImportError as error:
        raise ImportError('the engine "ray" needs the package ray: pip install "leafbench[ray]"') from error
    begun_here = not ray.is_initialized()
    if begun_here:
        # A cluster has its own number of cores.
        ray.init(address=address, num_cpus=None if address else workers, include_dashboard=False, log_to_driver=False)

    @ray.remote(max_retries=RETRIES, num_cpus=1)  # type: ignore[untyped-decorator]
    def diagnosed(run: str) -> str:
        return _leafbench.diagnose_archived(place, run, model, estimates_only)

    try:
        left = iter(runs)
        running = [diagnosed.remote(run) for run in islice(left, RUNS_AHEAD * workers)]
        while running:
            ready, running = ray.wait(running)
            running += [diagnosed.remote(run) for run in islice(left, len(ready))]
            yield from ray.get(ready)
    finally:
        if begun_here:
            ray.shutdown()


class _Bar:
    """Progress on a terminal, and a line now and then elsewhere."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._shown_at = 0.0
        self._terminal = sys.stderr.isatty()

    def __call__(self, done: int, count: int) -> None:
        now = time.monotonic()
        if done < count and now - self._shown_at < (0.2 if self._terminal else 30.0):
            return
        self._shown_at = now
        left_s = (now - self._began) / done * (count - done)
        filled = 30 * done // count
        text = f"[{'#' * filled}{'.' * (30 - filled)}] {done} of {count} runs, {left_s:.0f} s left"
        end = "\n" if done == count or not self._terminal else ""
        print(f"\r{text}\033[K" if self._terminal else text, end=end, file=sys.stderr, flush=True)


def main(arguments: list[str] | None = None) -> int:
    """The command ``python -m leafbench.fleet``. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m leafbench.fleet", description="Diagnoses the runs of an archive.")
    actions = parser.add_subparsers(dest="action", required=True)
    command = actions.add_parser("diagnose", help="diagnose the runs that have no diagnosis yet")
    command.add_argument("archive", metavar="ARCHIVE", help="folder of the archive, or s3://BUCKET/PREFIX")
    command.add_argument("--engine", choices=ENGINES, default="local", help="threads of this process, or workers of Ray")
    command.add_argument("--workers", type=int, default=0, metavar="N", help="runs at once [default: one on each core]")
    command.add_argument("--address", metavar="A", help='address of a Ray cluster, such as "auto" [default: this machine]')
    command.add_argument("--baseline", default="equivalent", metavar="MODEL", help="model that each diagnosis begins with")
    command.add_argument("--estimates-only", action="store_true", help="no search for missing effects in each run alone")
    given = parser.parse_args(arguments)
    try:
        done = diagnose(
            given.archive,
            engine=given.engine,
            workers=given.workers,
            baseline=given.baseline,
            estimates_only=given.estimates_only,
            address=given.address,
            progress=_Bar(),
        )
    except KeyboardInterrupt:
        print("interrupted: give the command again to go on", file=sys.stderr)
        return 130
    except (ValueError, OSError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{given.archive}: {done} runs diagnosed")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
