"""Conceals a helper leaf in the spring of the mock rig, records two tests, and lets the diagnosis find it.

    python missing_physics.py

Jupyter and editors open the parts after ``# %%`` as cells.
"""

# %% A bench whose spring has a helper leaf that touches at 8 mm. The model of the bench has none.
import numpy as np

import leafbench

HELPER_LEAF = """
[[specimen.model.effect]]
code = "progressive_stiffness"

[specimen.model.effect.parameters]
extra_rate_n_per_mm = 15.0
knee_mm = 8.0
width_mm = 0.5
"""
bench = leafbench.bench_toml("mock") + HELPER_LEAF


def sine(name: str, mean_mm: float, frequency_hz: float, cycles: int) -> str:
    """Text of a profile: up to the mean, sines of 6 mm, down."""
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


# %% Check each test against the limits of the bench before it moves, then run it on the mock rig
tests = [sine("slow", 8.0, 0.25, 5), sine("quick", 7.0, 2.0, 12)]
for test in tests:
    plan = leafbench.plan(test, bench=bench)
    print(f"{plan.profile}: up to {plan.force_max_n:.0f} N, {plan.velocity_max_mm_s:.0f} mm/s, may run: {plan.may_run}")
recordings = [leafbench.simulate(test, bench=bench, rig=True) for test in tests]

# %% Diagnose. The callback shows how far it is.
diagnosis = leafbench.diagnose(
    recordings, bench=bench, progress=lambda share, step: print(f"\r{share:4.0%} {step:60}", end="", flush=True)
)
print(f"\n{diagnosis.verdict}: {diagnosis}")
for note in diagnosis.notes:
    print("note:", note.text)
for finding in diagnosis.effects:
    print(f"{finding.code}, {finding.confidence:.0%} sure: {finding.statement}")
    for value in finding.parameters:
        interval = "no interval" if value.ci95 is None else f"95 %: {value.ci95[0]:.3g} to {value.ci95[1]:.3g}"
        print(f"    {value.name} = {value.value:.3g} ({interval})")
print(f"held-out error {diagnosis.fit.baseline.nrmse_heldout:.2%} before, {diagnosis.fit.improved.nrmse_heldout:.2%} after")

# %% The improved bench predicts a test that nothing was fitted to
if diagnosis.improved_toml is None:
    raise SystemExit("the improved model is no better than the refitted baseline: there is nothing to predict with")
unseen = sine("unseen", 9.0, 1.0, 4)
measured = leafbench.simulate(unseen, bench=bench, rig=True, seed=7)
peak_n = measured.force_n.max()
for name, with_bench in (("bench as it was", bench), ("improved bench", diagnosis.improved_toml)):
    predicted_n = leafbench.simulate(unseen, bench=with_bench).force_n.max()
    print(f"{name}: peak {predicted_n:.0f} N, measured {peak_n:.0f} N, error {predicted_n / peak_n - 1:+.1%}")
error_share = leafbench.simulate(unseen, bench=diagnosis.improved_toml).force_n.max() / peak_n - 1
assert np.isfinite(error_share)

# %% The test to run next, if the diagnosis asks for one
if diagnosis.next_test is not None:
    print(f"next test ({diagnosis.next_test.duration_s:.0f} s): {diagnosis.next_test.why}")
