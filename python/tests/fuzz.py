"""Calls every function with random arguments of wrong types, shapes and values, for a few seconds.

    python fuzz.py [SECONDS] [SEED]

What may come: a result, an InputError or an OSError, in a short time. An exception of another kind or a crash of the
interpreter is a failure. Each call is written to a file before it is made, so that the last one is known after a crash.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from decimal import Decimal
from pathlib import Path

import numpy as np

import leafbench
from leafbench import fleet

#: Longest time that one call may take, s.
LONGEST_S = 20.0


class Liar:
    """Says that it is an array, and is none."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("no array")

    def __len__(self):
        return -1


ODD = [
    None, True, False, 0, 1, -1, 3, 2**31, 2**64, -(2**64), 10**400, 0.0, -0.0, 1e308, 5e-324, float("nan"), float("inf"),
    1 + 2j, Decimal("1.5"), "", " ", "a", "mock", "equivalent", "static-ramp", "\0", "\ud800", "x" * 100_000, "../../etc/passwd",
    "/", "/dev/null", "name = 1\n", "[" * 5000 + "\n", b"", b"abc", bytearray(b"abc"), [], (), {}, set(), [None], [[]], [1, 2, 3],
    ["a"], {"a": 1}, {"time_s": [0]}, object(), Liar(), int, len, lambda: None, Ellipsis, range(3), iter([1]), Path("absent.csv"),
    np.zeros(0), np.zeros(3), np.zeros((2, 2)), np.array(1.0), np.array(["a"]), np.array([None]), np.array([np.nan, 1.0]),
    np.arange(5, dtype=np.int8), np.arange(6.0)[::-2], np.zeros(3, dtype="M8[s]"), np.zeros(2, dtype=[("a", "f8")]),
    np.broadcast_to(1.0, (10**10,)),
]  # fmt: skip


def sound(generator: random.Random) -> leafbench.Recording:
    """Numbers of a random size and shape that are a recording."""
    samples = generator.choice([1, 2, 3, 10, 200])
    noise = np.random.default_rng(generator.randrange(2**32))
    scale = 10.0 ** generator.randint(-300, 300) if generator.random() < 0.3 else 1.0
    step_s = 10.0 ** generator.randint(-6, 3)
    return leafbench.Recording(
        np.arange(samples) * step_s, noise.normal(size=samples) * scale, noise.normal(size=samples) * scale * 80
    )


def value(generator: random.Random) -> object:
    """Anything."""
    kind = generator.random()
    if kind < 0.25:
        return sound(generator)
    if kind < 0.35:
        return [generator.choice(ODD), sound(generator)]
    if kind < 0.45:
        return generator.choices([0.0, 1.0, 2.0, -1e308, float("nan"), float("inf")], k=generator.randint(0, 6))
    return generator.choice(ODD)


def likely(generator: random.Random, name: str) -> object:
    """An argument that is right in most cases, so that the others are reached."""
    right = {
        "recordings": lambda: sound(generator),
        "left_out": lambda: [sound(generator)],
        "profile": lambda: "sine-6mm-2.5hz-10",
        "bench": lambda: generator.choice(["mock", "chula", None]),
        "model": lambda: generator.choice(["equivalent", "two-sided"]),
        "baseline": lambda: generator.choice(["equivalent", "two-sided", "five-link", None]),
        "known": lambda: generator.sample(leafbench.physics(), 2),
        "method": lambda: "least-squares",
        "fix": lambda: {generator.choice(["preload_n", "rate_n_per_mm"]): generator.choice([0.0, 1e308, -5.0])},
        "free": lambda: ["rate_n_per_mm"],
        "begin": lambda: generator.choice(["rest", "cycling", "unknown"]),
        "time_s": lambda: [0.0, 1.0, 2.0],
        "displacement_mm": lambda: [0.0, 1.0, 2.0],
        "force_n": lambda: [0.0, 1.0, 2.0],
    }
    return right[name]() if name in right and generator.random() < 0.6 else value(generator)


CALLS = {
    leafbench.Recording: (["time_s", "displacement_mm", "force_n"], ["command_mm", "command_n", "cycle", "flags", "name", "specimen"]),
    leafbench.Recording.from_table: (["table"], ["name", "specimen"]),
    leafbench.read: (["path"], []),
    leafbench.diagnose: (["recordings"], ["baseline", "known", "left_out", "bench", "mixed_specimens", "threads", "progress"]),
    leafbench.simulate: (["profile"], ["bench", "rig", "seed"]),
    leafbench.plan: (["profile"], ["bench"]),
    leafbench.identify: (["recordings", "model"], ["specimen", "method", "fix", "free", "begin", "seed", "progress"]),
    leafbench.archived_runs: (["place"], []),
    leafbench.read_archive: (["place", "runs"], []),
    leafbench.bench_toml: ([], ["bench"]),
    fleet.diagnose: (["archive"], ["engine", "workers", "baseline", "estimates_only", "address", "progress"]),
}


def shown(thing: object) -> str:
    return f"{thing!r}"[:120]


def main(seconds: float, seed: int) -> int:
    generator = random.Random(seed)
    counts: dict[str, int] = {}
    slowest = (0.0, "")
    end = time.monotonic() + seconds
    last = Path(tempfile.gettempdir()) / f"leafbench-fuzz-{seed}.txt"
    print(f"seed {seed}: after a crash, {last} has the call", flush=True)
    while time.monotonic() < end:
        call = generator.choice(list(CALLS))
        needed, optional = CALLS[call]
        names = needed + [name for name in optional if generator.random() < 0.3]
        arguments = {name: likely(generator, name) for name in names}
        line = f"{call.__qualname__}({', '.join(f'{n}={shown(a)}' for n, a in arguments.items())})"
        last.write_text(line, errors="backslashreplace")
        began = time.monotonic()
        try:
            found = call(**arguments)
            outcome = "result"
            repr(found)
        except (leafbench.InputError, OSError) as error:
            outcome = type(error).__name__
            assert str(error), line
        except Exception as error:
            if isinstance(error, TypeError) and callable(arguments.get("progress")):
                # It was called, and takes other arguments.
                continue
            print(f"seed {seed}: {line}\nraised {type(error).__name__}: {error}", file=sys.stderr)
            return 1
        took_s = time.monotonic() - began
        slowest = max(slowest, (took_s, line))
        counts[outcome] = counts.get(outcome, 0) + 1
    last.unlink(missing_ok=True)
    print(f"seed {seed}: {sum(counts.values())} calls, {counts}, slowest {slowest[0]:.2f} s: {slowest[1]}")
    return int(slowest[0] > LONGEST_S)


if __name__ == "__main__":
    import faulthandler

    faulthandler.enable()
    given = sys.argv[1:]
    sys.exit(main(float(given[0]) if given else 5.0, int(given[1]) if len(given) > 1 else time.time_ns() % 2**32))
