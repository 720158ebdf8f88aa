#!/usr/bin/env python3
"""Other programs read an archive: DuckDB, Polars and, where PySpark and Java are, Spark give the same ten answers as the run files.
The same archive in an object store (moto, an S3 server) has the same bytes. Usage: archive_check.py PATH_OF_LEAFBENCH RUN_FILE...
"""
import json
import os
import pathlib
import sqlite3
import subprocess
import sys
import tempfile

import duckdb
import polars

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "formats"))
import aggregates  # noqa: E402
from check import Run, awkward_run, write_run  # noqa: E402


def make_runs(sources, folder):
    """Run files of two specimens and two benches, from those of a demo, each with an id of its own."""
    made = []
    for number in range(6):
        source = sources[number % len(sources)]
        path = folder / f"run-{number}.leafrun"
        path.write_bytes(source.read_bytes())
        database = sqlite3.connect(path)
        header, outcome = (json.loads(text) for text in database.execute("SELECT header_json, outcome_json FROM run").fetchone())
        blocks = database.execute("SELECT first_tick, data FROM blocks ORDER BY seq").fetchall()
        # Other lengths, so that no two runs are the same.
        blocks = blocks[:len(blocks) - 7 * number]
        header |= {"run_id": f"run-{number}", "specimen": ["pack 1/a", "pack-2"][number % 2],
                   "started_utc": f"2026-{9 + number // 3:02}-03T10:00:00Z"}
        header["bench_toml"] = f'name = "bench-{number // 2}"\n'
        outcome["samples"] = sum(len(data) // 40 for _, data in blocks)
        write_run(database, header, blocks, outcome)
        made.append(path)
    return made


def duckdb_answers(archive):
    connection = duckdb.connect()
    for name in ("samples", "cycles", "runs"):
        pattern = f"{archive}/{name}/**/*.parquet"
        connection.execute(f"CREATE VIEW {name} AS FROM read_parquet('{pattern}', hive_partitioning = true)")
    return aggregates.by_sql(lambda sql: connection.execute(sql).fetchall())


def spark_answers(archive):
    from pyspark.sql import SparkSession
    spark = SparkSession.builder.master("local[2]").config("spark.ui.enabled", "false").getOrCreate()
    for name in ("samples", "cycles", "runs"):
        spark.read.parquet(f"{archive}/{name}").createOrReplaceTempView(name)
    answers = aggregates.by_sql(lambda sql: [tuple(row) for row in spark.sql(sql).collect()])
    spark.stop()
    return answers


def check_engines(archive, runs):
    # A whole cycle counts: the archive says which are.
    answers = duckdb_answers(archive)
    truth = aggregates.from_run_files(runs)
    energies = truth["work of a loop in each complete cycle"]
    complete = answers["work of a loop in each complete cycle"]
    assert len(complete) > 0.9 * len(energies) - len(runs), (len(complete), len(energies))
    truth["work of a loop in each complete cycle"] = {key: energies[key] for key in complete}
    aggregates.compare(answers, truth, "DuckDB and the run files", digits=1e-3)
    aggregates.compare(aggregates.by_polars(archive, polars), answers, "Polars and DuckDB")
    engines = ["DuckDB", "Polars"]
    try:
        import pyspark  # noqa: F401
    except ImportError:
        print("SKIPPED: Spark, because the package pyspark is not installed")
    else:
        aggregates.compare(spark_answers(archive), answers, "Spark and DuckDB")
        engines.append("Spark")
    return engines


def contents(folder):
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def check_object_store(leafbench, archive, runs):
    """The same runs into a bucket: the same objects; a changed byte is found; a lost object is named."""
    import boto3
    from moto.server import ThreadedMotoServer
    server = ThreadedMotoServer(port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    keys = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1", "AWS_ENDPOINT": endpoint,
            "AWS_ALLOW_HTTP": "true"}
    s3 = boto3.client("s3", endpoint_url=endpoint, region_name="us-east-1", aws_access_key_id="test", aws_secret_access_key="test")
    s3.create_bucket(Bucket="lab")

    def call(*arguments, code=0):
        done = subprocess.run([leafbench, *arguments], env=os.environ | keys, capture_output=True, text=True)
        assert done.returncode == code, f"{arguments}: exit code {done.returncode}: {done.stdout}{done.stderr}"
        return done.stdout + done.stderr

    place = "s3://lab/some/prefix"
    call("archive", place, *runs[:2])
    call("archive", place, *runs)
    assert "0 runs added" in call("archive", place, *runs)
    call("verify", place, "--runs", *runs)
    listed = s3.list_objects_v2(Bucket="lab", Prefix="some/prefix/")["Contents"]
    stored = {item["Key"].removeprefix("some/prefix/"): s3.get_object(Bucket="lab", Key=item["Key"])["Body"].read() for item in listed}
    here = contents(archive)
    samples = [name for name in here if name.startswith("samples/")]
    assert len(samples) == len(runs) and all(stored[name] == here[name] for name in samples)
    assert "_archive/writer.json" not in stored, "the lock stayed"
    name = samples[0]
    changed = bytearray(stored[name])
    changed[len(changed) // 2] ^= 1
    s3.put_object(Bucket="lab", Key=f"some/prefix/{name}", Body=bytes(changed))
    assert name in call("verify", place, code=1)
    s3.delete_object(Bucket="lab", Key=f"some/prefix/{name}")
    assert f"{name} is missing" in call("verify", place, code=1)
    server.stop()
    refused = call("archive", place, *runs, code=2)
    assert "check the connection" in refused, refused


def main():
    leafbench = str(pathlib.Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as name:
        work = pathlib.Path(name)
        sources = [pathlib.Path(path) for path in sys.argv[2:]]
        runs = make_runs(sources, work)
        awkward = awkward_run(sources[0], work)
        archive = work / "archive"
        refused = subprocess.run([leafbench, "archive", archive, *runs, awkward], capture_output=True, text=True)
        # Its numbers have hundreds of digits.
        assert refused.returncode == 1 and "awkward" in refused.stderr + refused.stdout, refused
        subprocess.run([leafbench, "verify", archive, "--runs", *runs], check=True)
        engines = check_engines(archive, [Run(path) for path in runs])
        check_object_store(leafbench, archive, runs)
    print(f"{', '.join(engines)}: the same ten answers from the archive as from the run files; the same archive in an object store")


if __name__ == "__main__":
    main()
