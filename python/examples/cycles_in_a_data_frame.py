"""Reads a recording into a data frame, and computes peak force, travel and loop energy of each cycle.

    python cycles_in_a_data_frame.py [RECORDING.csv or RUN.leafrun]

Without an argument a test is run on the mock rig. Jupyter and editors open the parts after ``# %%`` as cells.
"""

# %% A recording: arrays of numpy, which are views of its memory
import sys

import numpy as np
import polars

import leafbench

if len(sys.argv) > 1:
    recording = leafbench.read(sys.argv[1])
else:
    recording = leafbench.simulate("sine-6mm-2.5hz-10", rig=True)
for note in recording.notes:
    print("note:", note)
print(recording)
print(f"largest force {recording.force_n.max():.1f} N, largest travel {np.ptp(recording.displacement_mm):.3f} mm")

# %% The same as a data frame of polars, without a copy; to_pandas() and to_arrow() work alike
frame = recording.to_polars()
print(frame.head(3))

# %% Values of each counted cycle
if "cycle" not in frame.columns:
    sys.exit("the recording has no column cycle, so there is nothing to count")
cycles = (
    frame.filter(polars.col("cycle") > 0)
    # Energy is the integral of force over displacement: trapezoids in N mm, and 1000 N mm are 1 J.
    .with_columns(
        energy_j=(polars.col("force_n") + polars.col("force_n").shift(1)) / 2 * polars.col("displacement_mm").diff() / 1000
    )
    .group_by("cycle", maintain_order=True)
    .agg(
        peak_force_n=polars.col("force_n").max(),
        travel_mm=polars.col("displacement_mm").max() - polars.col("displacement_mm").min(),
        loop_energy_j=polars.col("energy_j").sum(),
    )
)
print(cycles)

# %% What a technician asks: does the spring change from cycle to cycle?
energy_j = cycles["loop_energy_j"].to_numpy()
spread_percent = 100 * np.std(energy_j) / np.mean(energy_j)
print(f"loop energy {np.mean(energy_j):.3f} J, spread between cycles {spread_percent:.2f} %")
