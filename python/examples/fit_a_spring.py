"""Fits the rate and the friction of a spring to columns of numbers, and says how sure the values are.

    python fit_a_spring.py [TABLE.csv]

The table needs the columns time_s, displacement_mm and force_n; pandas reads it. Without an argument one is made up. Jupyter and
editors open the parts after ``# %%`` as cells.
"""

# %% Columns from anywhere become a recording. Mistakes are named with column and index.
import sys

import numpy as np
import pandas

import leafbench

if len(sys.argv) > 1:
    table = pandas.read_csv(sys.argv[1])
else:
    # Three slow cycles of a spring of 80 N/mm with 12 % dry friction, and noise of 1 N.
    time_s = np.arange(0.0, 18.85, 0.01)
    displacement_mm = 10 - 10 * np.cos(time_s)
    friction = 1 + 0.12 * np.sign(np.sin(time_s))
    noise_n = np.random.default_rng(1).normal(scale=1.0, size=time_s.size)
    table = pandas.DataFrame(
        {"time_s": time_s, "displacement_mm": displacement_mm, "force_n": 80 * displacement_mm * friction + noise_n}
    )
recording = leafbench.Recording.from_table(table, name="my spring")
print(recording)

broken = table.copy()
broken.loc[3, "force_n"] = np.nan
try:
    leafbench.Recording.from_table(broken, name="my spring")
except leafbench.InputError as error:
    print(f"refused: {error}")
    print(f"the place: column {error.column}, index {error.index}")

# %% Fit the model `equivalent`. The spring has no preload, so that parameter is held.
for name, what in leafbench.models().items():
    print(f"{name}: {what}")
found = leafbench.identify(recording, model="equivalent", fix={"preload_n": 0.0}, begin="rest")
for parameter in found.parameters:
    interval = "held" if not parameter.free else "no interval" if parameter.ci95 is None else "95 %: {:.4g} to {:.4g}".format(*parameter.ci95)
    print(f"{parameter.name:24} {parameter.value:10.4g} {parameter.unit:6} {interval}")
for error in found.errors:
    print(f"remaining error on {error.of}: {error.error_n:.2f} N, {error.error_percent:.2f} % of the range of force")
for warning in found.warnings:
    print("warning:", warning)

# %% The specimen file is for `file` under [specimen] of a bench, and for --specimen of the command line
print(found.specimen_toml)
