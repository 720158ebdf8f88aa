"""Recordings and benches that the tests share."""

from __future__ import annotations

import numpy as np
import pytest

import leafbench

#: A helper leaf in the spring of the mock rig, which its model does not have.
HELPER_LEAF = """
[[specimen.model.effect]]
code = "progressive_stiffness"

[specimen.model.effect.parameters]
extra_rate_n_per_mm = 15.0
knee_mm = 8.0
width_mm = 0.5
"""


def sine(name: str, mean_mm: float, frequency_hz: float, cycles: int) -> str:
    """A profile: up to the mean, sines of 6 mm, down."""
    return f"""
name = "{name}"
control = "displacement"
[[block]]
segment = [
    {{ kind = "ramp", to_mm = {mean_mm}, duration_s = 2.0 }},
    {{ kind = "sine", mean_mm = {mean_mm}, amplitude_mm = 6.0, frequency_hz = {frequency_hz}, cycles = {cycles}, taper_cycles = 1 }},
    {{ kind = "ramp", to_mm = 0.0, duration_s = 2.0 }},
]
"""


SLOW, QUICK = sine("slow", 8.0, 0.25, 5), sine("quick", 7.0, 2.0, 12)


def loops(samples: int = 2000, name: str = "loops") -> leafbench.Recording:
    """Slow cycles of a spring of 80 N/mm with 10 % dry friction."""
    time_s = np.arange(samples) * 0.01
    displacement_mm = 5 - 5 * np.cos(time_s)
    force_n = 80 * displacement_mm * (1 + 0.1 * np.sign(np.sin(time_s)))
    return leafbench.Recording(time_s, displacement_mm, force_n, name=name)


@pytest.fixture(scope="session")
def helper_leaf_bench() -> str:
    """Text of a bench whose spring has a helper leaf."""
    return leafbench.bench_toml("mock") + HELPER_LEAF


@pytest.fixture(scope="session")
def measured(helper_leaf_bench: str) -> list[leafbench.Recording]:
    """A slow and a quick test of that spring."""
    return [leafbench.simulate(profile, bench=helper_leaf_bench, rig=True) for profile in (SLOW, QUICK)]
