"""Ten questions to an archive, asked of DuckDB, Polars and Spark, and answered from the run files without the archive."""
import math

SAMPLES, CYCLES, RUNS = ("samples/**/*.parquet", "cycles/**/*.parquet", "runs/**/*.parquet")

# Name: SQL over the views samples, cycles and runs. DuckDB and Spark take the same text; each answers with rows of (key, value).
QUESTIONS = {
    "samples of each specimen":
        "SELECT specimen_name, count(*) FROM samples JOIN runs USING (run_id) GROUP BY specimen_name",
    "highest force of each run": "SELECT run_id, max(force_n) FROM samples GROUP BY run_id",
    "lowest displacement of each run": "SELECT run_id, min(displacement_mm) FROM samples GROUP BY run_id",
    "sum of all forces of each run": "SELECT run_id, sum(force_n) FROM samples GROUP BY run_id",
    "mean displacement of each cycle":
        "SELECT concat(run_id, ' ', cycle), avg(CAST(displacement_mm AS DOUBLE)) FROM samples GROUP BY run_id, cycle",
    "flagged samples of each run":
        "SELECT run_id, sum(CASE WHEN flags <> 0 THEN 1 ELSE 0 END) FROM samples GROUP BY run_id",
    "samples without twin of each run": "SELECT run_id, count(*) - count(twin_force_n) FROM samples GROUP BY run_id",
    "deviation of the twin (root mean square) of each specimen":
        "SELECT specimen_name, sqrt(avg(power(CAST(force_n - twin_force_n AS DOUBLE), 2)))"
        " FROM samples JOIN runs USING (run_id) GROUP BY specimen_name",
    "longest time of each bench": "SELECT bench, max(time_s) FROM samples JOIN runs USING (run_id) GROUP BY bench",
    "work of a loop in each complete cycle":
        "SELECT concat(run_id, ' ', cycle), loop_energy_j FROM cycles WHERE complete = 1",
}


def from_run_files(runs):
    """The answers by plain Python. `runs` are objects with `header` and `columns` (lists of numbers or None)."""
    def group(key, value, fold):
        groups = {}
        for run in runs:
            for i in range(run.rows):
                groups.setdefault(key(run, i), []).append(value(run, i))
        return {k: fold(v) for k, v in groups.items()}

    def column(name):
        return lambda run, i: run.columns[name][i]

    def run_id(run, _):
        return run.header["run_id"]

    def specimen(run, _):
        return run.header["specimen"]

    def bench(run, _):
        line = next(line for line in run.header["bench_toml"].splitlines() if line.startswith("name"))
        return line.split('"')[1]

    def residual(run, i):
        twin = run.columns["twin_force_n"][i]
        return None if twin is None else (run.columns["force_n"][i] - twin) ** 2

    def root_mean(values):
        values = [v for v in values if v is not None]
        return math.sqrt(sum(values) / len(values)) if values else None

    def cycle(run, i):
        return f"{run.header['run_id']} {run.columns['cycle'][i]}"

    names = list(QUESTIONS)
    return dict(zip(names, [
        group(specimen, lambda *_: 1, sum),
        group(run_id, column("force_n"), max),
        group(run_id, column("displacement_mm"), min),
        group(run_id, column("force_n"), math.fsum),
        group(cycle, column("displacement_mm"), lambda values: math.fsum(values) / len(values)),
        group(run_id, lambda run, i: int(run.columns["flags"][i] != 0), sum),
        group(run_id, lambda run, i: int(run.columns["twin_force_n"][i] is None), sum),
        group(specimen, residual, root_mean),
        group(bench, column("time_s"), max),
        loop_energies(runs),
    ], strict=True))


def loop_energies(runs):
    """Work of each complete cycle, by the rule of docs/formats.md: the loop is closed, trapezoids of force over displacement."""
    found = {}
    for run in runs:
        x, f, cycle = (run.columns[name] for name in ("displacement_mm", "force_n", "cycle"))
        samples = {}
        for i in range(run.rows):
            if cycle[i] > 0:
                samples.setdefault(cycle[i], []).append(i)
        for number, rows in samples.items():
            closed = [*rows, rows[0]]
            work = math.fsum((f[a] + f[b]) / 2 * (x[b] - x[a]) for a, b in zip(closed, closed[1:])) * 1e-3
            found[f"{run.header['run_id']} {number}"] = work
    return found


def by_sql(ask):
    """The answers of an engine that takes SQL: `ask` gives the rows of a query."""
    return {name: number_rows(ask(sql)) for name, sql in QUESTIONS.items()}


def by_polars(archive, polars):
    """The answers of Polars, in its own words."""
    def table(pattern):
        return polars.scan_parquet(f"{archive}/{pattern}", hive_partitioning=True)

    c = polars.col
    samples, cycles = table(SAMPLES), table(CYCLES)
    joined = samples.join(table(RUNS).select("run_id", "specimen_name", "bench"), on="run_id")
    number = polars.Float64
    key = polars.concat_str("run_id", c("cycle").cast(polars.String), separator=" ")
    questions = [
        joined.group_by("specimen_name").agg(polars.len()),
        samples.group_by("run_id").agg(c("force_n").max()),
        samples.group_by("run_id").agg(c("displacement_mm").min()),
        samples.group_by("run_id").agg(c("force_n").sum()),
        samples.group_by(key).agg(c("displacement_mm").cast(number).mean()),
        samples.group_by("run_id").agg((c("flags") != 0).sum()),
        samples.group_by("run_id").agg(c("twin_force_n").null_count()),
        joined.group_by("specimen_name").agg((c("force_n") - c("twin_force_n")).cast(number).pow(2).mean().sqrt()),
        joined.group_by("bench").agg(c("time_s").max()),
        cycles.filter(c("complete") == 1).select(key, "loop_energy_j"),
    ]
    return {name: number_rows(q.collect().rows()) for name, q in zip(QUESTIONS, questions, strict=True)}


def number_rows(rows):
    """Rows of (key, value) as a dictionary of plain numbers."""
    found = {}
    for key, value in rows:
        assert key not in found, f"{key} is twice in an answer"
        found[str(key)] = None if value is None else float(value)
    return found


def compare(one, other, what, digits=0.0):
    """Each answer has the same keys, and numbers that differ by the rounding of doubles, or by the `digits` that an archive keeps."""
    for name in QUESTIONS:
        assert one[name].keys() == other[name].keys(), f"{what}, {name}: {set(one[name]) ^ set(other[name])}"
        assert one[name], f"{what}, {name}: no answer"
        for key, value in one[name].items():
            wanted = other[name][key]
            if value is None or wanted is None:
                assert value is wanted, f"{what}, {name}, {key}: {value} and {wanted}"
                continue
            allowed = digits * (1e5 if name.startswith("sum") else 1.0) + 1e-9 * abs(wanted)
            assert abs(value - wanted) <= allowed, f"{what}, {name}, {key}: {value} and {wanted}"
