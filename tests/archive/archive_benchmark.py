#!/usr/bin/env python3
"""Size and speed of an archive beside pandas with CSV and asammdf with MF4, on this machine.
Usage: archive_benchmark.py PATH_OF_LEAFBENCH RUN_FILE [RUNS] [FOLDER]
RUN_FILE is a recording of the mock rig with noise; RUNS (default 1000) copies of its first 60 s are made, each with another id,
specimen and day.
"""
import json
import pathlib
import sqlite3
import subprocess
import sys
import tempfile
import time
import zlib

import duckdb
import pandas
import polars
from asammdf import MDF

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "formats"))
from check import RECORD, write_run  # noqa: E402

SECONDS = 60


def timed(what, work, unit=None, count=None):
    began = time.monotonic()
    result = work()
    took = time.monotonic() - began
    rate = f", {count / took:,.0f} {unit}" if count else ""
    print(f"{what:<60} {took:9.2f} s{rate}", flush=True)
    return result, took


def make_runs(source, folder, count):
    """Copies of a run. Its counts are moved by a little in each, so that no two files have the same samples."""
    database = sqlite3.connect(f"file:{source}?mode=ro", uri=True)
    header, outcome = (json.loads(text) for text in database.execute("SELECT header_json, outcome_json FROM run").fetchone())
    rate = header["sample_rate_hz"]
    blocks, samples = [], 0
    for first, data in database.execute("SELECT first_tick, data FROM blocks ORDER BY seq"):
        if samples >= SECONDS * rate:
            break
        blocks.append((first, data))
        samples += len(data) // RECORD.size
    template = folder / "template.leafrun"
    template.write_bytes(source.read_bytes())
    database = sqlite3.connect(template)
    write_run(database, header, blocks, outcome | {"samples": samples})
    database.execute("VACUUM")
    database.close()
    runs = folder / "runs"
    runs.mkdir()
    for number in range(count):
        path = runs / f"run-{number:05}.leafrun"
        path.write_bytes(template.read_bytes())
        database = sqlite3.connect(path)
        header |= {"run_id": f"run-{number:05}", "specimen": f"pack-{number % 40:02}",
                   "started_utc": f"2026-{1 + number % 12:02}-{1 + number % 28:02}T10:00:00Z"}
        text = json.dumps(header)
        database.execute("UPDATE run SET header_json = ?, header_crc32 = ?", (text, zlib.crc32(text.encode())))
        database.commit()
        database.close()
    return runs, samples


def main():
    leafbench, source = (pathlib.Path(path).resolve() for path in sys.argv[1:3])
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 1000
    with tempfile.TemporaryDirectory(dir=sys.argv[4] if len(sys.argv) > 4 else None) as name:
        work = pathlib.Path(name)
        runs, samples = make_runs(source, work, count)
        archive = work / "archive"
        print(f"{count} runs of {samples} samples each")
        _, took = timed("archive", lambda: subprocess.run([leafbench, "archive", archive, runs], check=True, capture_output=True))
        stored = sum(path.stat().st_size for path in (archive / "samples").rglob("*.parquet"))
        print(f"{stored / (count * samples):.2f} bytes a sample, {60 * count / took:,.0f} runs a minute")
        timed("the same again: nothing new",
              lambda: subprocess.run([leafbench, "archive", archive, runs], check=True, capture_output=True))
        timed("verify", lambda: subprocess.run([leafbench, "verify", archive], check=True, capture_output=True))
        csv, mf4 = work / "csv", work / "mf4"
        files = sorted(runs.glob("*.leafrun"))
        for folder, form in ((csv, "csv"), (mf4, "mf4")):
            def export(folder=folder, form=form):
                for file in files:
                    subprocess.run([leafbench, "export", file, "--format", form, "--out", folder], check=True, capture_output=True)
            timed(f"export as {form}", export)
            size = sum(path.stat().st_size for path in folder.glob(f"run-?????.{form}"))
            print(f"{size / (count * samples):.2f} bytes a sample")
        tables = {name: f"read_parquet('{archive}/{name}/**/*.parquet', hive_partitioning = true)" for name in ("samples", "runs", "cycles")}
        query = (f"SELECT specimen_name, max(force_n), avg(displacement_mm) FROM {tables['samples']} JOIN {tables['runs']} "
                 "USING (run_id) GROUP BY specimen_name")
        first, duck = timed("DuckDB: highest force and mean displacement of each specimen",
                            lambda: sorted(duckdb.sql(query).fetchall()))
        def by_polars():
            table = polars.scan_parquet(f"{archive}/samples/**/*.parquet", hive_partitioning=True)
            named = polars.scan_parquet(f"{archive}/runs/**/*.parquet", hive_partitioning=True).select("run_id", "specimen_name")
            answer = table.join(named, on="run_id").group_by("specimen_name")
            return answer.agg(polars.col("force_n").max(), polars.col("displacement_mm").mean()).sort("specimen_name").collect()
        timed("Polars: the same", by_polars)
        def by_pandas():
            rows = []
            for path in sorted(csv.glob("run-?????.csv")):
                table = pandas.read_csv(path, usecols=["displacement_mm", "force_n"], comment="#")
                rows.append((int(path.stem[-5:]) % 40, table["force_n"].max(), table["displacement_mm"].mean()))
            return pandas.DataFrame(rows).groupby(0).agg({1: "max", 2: "mean"})
        second, slow = timed("pandas on the CSV files: the same", by_pandas)
        def by_asammdf():
            rows = []
            for path in sorted(mf4.glob("run-?????.mf4")):
                with MDF(path) as mdf:
                    rows.append((int(path.stem[-5:]) % 40, mdf.get("force_n").samples.max(), mdf.get("displacement_mm").samples.mean()))
            return pandas.DataFrame(rows).groupby(0).agg({1: "max", 2: "mean"})
        third, middle = timed("asammdf on the MF4 files: the same", by_asammdf)
        for (_, force, travel), csv_row, mf4_row in zip(first, second.itertuples(), third.itertuples(), strict=True):
            for other in (csv_row, mf4_row):
                assert abs(float(force) - other[1]) < 2e-3 and abs(float(travel) - other[2]) < 1e-5, (force, travel, other)
        print(f"DuckDB on the archive: {slow / duck:.0f} times as fast as pandas, {middle / duck:.0f} times as fast as asammdf")
        timed("DuckDB: work of a loop over all cycles",
              lambda: duckdb.sql(f"SELECT run_id, avg(loop_energy_j) FROM {tables['cycles']} GROUP BY run_id").fetchall())


if __name__ == "__main__":
    main()
