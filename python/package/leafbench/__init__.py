"""Recordings, diagnosis, simulation and identification of leaf springs on a test bench.

Units are in the names: ``force_n`` is in N, ``displacement_mm`` in mm, ``time_s`` in s. Loading is positive.

>>> import leafbench
>>> recording = leafbench.simulate("static-ramp-12s")
>>> found = leafbench.identify(recording, model="equivalent", fix={"preload_n": 0.0}, begin="rest")
>>> round(found["rate_n_per_mm"].value, 1)
72.0
"""

from ._archive import ArchivedRun, archived_runs, read_archive
from ._arguments import CONFIGS
from ._calls import bench_toml, benches, diagnose, identify, models, physics, plan, profiles, simulate
from ._diagnosis import (
    Alternative,
    AttachedEffect,
    Candidate,
    Curve,
    Diagnosis,
    Errors,
    Exponent,
    Finding,
    FitErrors,
    ImprovedModel,
    Law,
    LeftOut,
    Location,
    Map,
    NextTest,
    Note,
    NoteSize,
    NotTestable,
    Proof,
    Rung,
    Value,
    Yardstick,
)
from ._errors import ArgumentTypeError, InputError, InternalError
from ._leafbench import __version__
from ._recording import Recording, read
from ._results import FitError, FittedParameter, Identification, Margin, Plan

__all__ = [
    "CONFIGS",
    "Alternative",
    "ArchivedRun",
    "ArgumentTypeError",
    "AttachedEffect",
    "Candidate",
    "Curve",
    "Diagnosis",
    "Errors",
    "Exponent",
    "Finding",
    "FitError",
    "FitErrors",
    "FittedParameter",
    "Identification",
    "ImprovedModel",
    "InputError",
    "InternalError",
    "Law",
    "LeftOut",
    "Location",
    "Map",
    "Margin",
    "NextTest",
    "NotTestable",
    "Note",
    "NoteSize",
    "Plan",
    "Proof",
    "Recording",
    "Rung",
    "Value",
    "Yardstick",
    "__version__",
    "archived_runs",
    "bench_toml",
    "benches",
    "diagnose",
    "identify",
    "models",
    "physics",
    "plan",
    "profiles",
    "read",
    "read_archive",
    "simulate",
]
