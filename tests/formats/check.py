#!/usr/bin/env python3
"""Other programs read what `leafbench export` writes: asammdf, pandas, Polars and DuckDB. Every number is compared with the run
file, bit by bit; the run file is read here from its description in docs/formats.md alone.
Usage: check.py PATH_OF_LEAFBENCH [FOLDER_OF_A_DEMO]
"""
import copy
import csv
import hashlib
import json
import math
import pathlib
import sqlite3
import struct
import subprocess
import sys
import tempfile
import zlib
from datetime import datetime

import duckdb
import numpy
import pandas
import polars
import pyarrow.parquet
from asammdf import MDF

DOCUMENT = pathlib.Path(__file__).resolve().parents[2] / "docs/formats.md"
RECORD = struct.Struct("<IiiddIIHBB")
UNITS = {"time_s": "s", "displacement_mm": "mm", "force_n": "N", "command_mm": "mm", "command_n": "N", "cycle": "1",
         "segment": "1", "twin_force_n": "N", "flags": "1", "cycles_averaged": "1"}
TYPES = {"cycle": "uint32", "segment": "uint32", "flags": "uint16", "cycles_averaged": "uint32"}
MODES = {1: "command_mm", 2: "command_n"}
NULLABLE = ("command_mm", "command_n", "twin_force_n")


# ---- the run file, as docs/formats.md describes it

class Run:
    """Header, outcome, events and columns of a run file. An empty cell is None."""

    def __init__(self, path):
        self.path = path
        database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
        header, outcome, zero = database.execute(
            "SELECT header_json, outcome_json, zero_tick FROM run, totals").fetchone()
        self.header, self.outcome = json.loads(header), json.loads(outcome)
        self.events = database.execute("SELECT time_s, kind, text FROM events ORDER BY seq").fetchall()
        force, travel = self.header["force_channel"], self.header["displacement_channel"]
        rate = self.header["sample_rate_hz"]
        rows, modes, after_gap = [], [], 0
        blocks = "SELECT seq, first_tick, sample_count, crc32, data FROM blocks ORDER BY seq"
        for seq, tick, count, crc, data in database.execute(blocks):
            if zlib.crc32(struct.pack("<QQQ", seq, tick, count) + data) != crc:
                after_gap = 1
                continue
            for offset, force_counts, travel_counts, command, twin, cycle, segment, flags, mode, _ in RECORD.iter_unpack(data):
                if mode and MODES[mode] not in modes:
                    modes.append(MODES[mode])
                rows.append({
                    "time_s": (tick + offset - zero) / rate,
                    "displacement_mm": value(travel_counts, travel),
                    "force_n": value(force_counts, force),
                    MODES.get(mode): command,
                    "cycle": cycle,
                    "segment": segment,
                    "twin_force_n": None if math.isnan(twin) else twin,
                    # An export marks the first sample after a damaged block.
                    "flags": flags | after_gap,
                })
                after_gap = 0
        names = ["time_s", "displacement_mm", "force_n", *modes, "cycle", "segment", "twin_force_n", "flags"]
        self.columns = {name: [row.get(name) for row in rows] for name in names}
        self.rows = len(rows)

    def part(self, keep):
        """The same run with the rows for which `keep` is true."""
        part = copy.copy(self)
        kept = [i for i in range(self.rows) if keep(i)]
        part.columns = {name: [cells[i] for i in kept] for name, cells in self.columns.items()}
        part.rows = len(kept)
        return part


def value(counts, channel):
    return counts * channel["scale_per_count"] - channel["offset"] - channel["tare"]


# ---- run files that the mock rig does not make

def write_run(database, header, blocks, outcome):
    """Writes header, blocks of packed records and outcome over those of a copied run file, with their checksums."""
    texts = [json.dumps(text) for text in (header, outcome)]
    database.execute("UPDATE run SET header_json = ?, header_crc32 = ?, outcome_json = ?, outcome_crc32 = ?",
                     [item for text in texts for item in (text, zlib.crc32(text.encode()))])
    database.execute("DELETE FROM blocks")
    for seq, (tick, data) in enumerate(blocks, 1):
        count = len(data) // RECORD.size
        database.execute("INSERT INTO blocks VALUES (?, ?, ?, ?, ?)",
                         (seq, tick, count, zlib.crc32(struct.pack("<QQQ", seq, tick, count) + data), data))
    first, (last_tick, last) = blocks[0][0], blocks[-1]
    last = last_tick + RECORD.unpack_from(last, len(last) - RECORD.size)[0]
    events, = database.execute("SELECT count(*) FROM events").fetchone()
    totals = (first, first, last, outcome["samples"], len(blocks), events, 1)
    database.execute("UPDATE totals SET zero_tick = ?, first_tick = ?, last_tick = ?, samples = ?, blocks = ?, events = ?, "
                     "closed = ?, crc32 = ?", (*totals, zlib.crc32(struct.pack("<7Q", *totals))))
    database.commit()


def awkward_run(source, folder):
    """Both control modes, lost samples, no twin in places, all flags, tiny and huge numbers, texts with XML in them."""
    path = folder / "awkward.leafrun"
    path.write_bytes(source.read_bytes())
    database = sqlite3.connect(path)
    header = json.loads(database.execute("SELECT header_json FROM run").fetchone()[0])
    header |= {"run_id": "awkward", "operator": "=1+1 <Ä & \"B\">", "specimen": "leaf\t7\u0001 ]]>", "sample_rate_hz": 1000.0,
               "started_utc": "2024-02-29T23:59:59Z"}
    header["force_channel"] = {"scale_per_count": 0.1, "offset": -1 / 3, "tare": 1e-9}
    blocks, samples = [], 0
    for first in range(7_000_000_000, 7_000_003_000, 300):
        records = []
        for i in range(0, 300):
            tick = first + i
            if first == 7_000_000_900 and 100 <= i < 105:
                continue
            mode = tick // 700 % 3
            command = [0.0, 1e-300 * i, -1.7976931348623157e308][mode] if mode else 0.0
            twin = math.nan if tick % 7 == 0 else [0.1 + 0.2, -0.0, 5e-324][tick % 3]
            flags = 1 if i == 105 and first == 7_000_000_900 else 1 << (tick % 8) if tick % 2 else 0
            flags = flags & ~1 if not (i == 105 and first == 7_000_000_900) else flags
            records.append(RECORD.pack(i, -2**31 + tick % 97, 2**31 - 1 - tick % 89, command, twin,
                                       2**32 - 1 if i == 299 else 0, tick % 2**32, flags, mode, 0))
            samples += 1
        blocks.append((first, b"".join(records)))
    outcome = {"ending": "completed", "cause": "", "samples": samples, "lost": 5, "late": 0, "cycles_completed": 0}
    write_run(database, header, blocks, outcome)
    return path


def damaged_run(source, folder):
    """One block of the run has a wrong byte."""
    path = folder / "damaged.leafrun"
    path.write_bytes(source.read_bytes())
    database = sqlite3.connect(path)
    seq, data = database.execute("SELECT seq, data FROM blocks ORDER BY seq LIMIT 1 OFFSET 20").fetchone()
    database.execute("UPDATE blocks SET data = ? WHERE seq = ?", (data[:-1] + b"\x55", seq))
    database.commit()
    return path


# ---- comparison

def same(name, got, missing, wanted, reader):
    """Every number of a column to the last bit; empty cells where the run file has none, and nowhere else."""
    empty = numpy.array([cell is None for cell in wanted])
    assert len(got) == len(wanted), f"{reader}: {name} has {len(got)} rows, not {len(wanted)}"
    kind = numpy.dtype(TYPES.get(name, "float64"))
    assert got.dtype == kind, f"{reader}: {name} is {got.dtype}, not {kind}"
    assert numpy.array_equal(missing, empty), f"{reader}: {name} is empty in other rows than the run file"
    wanted = numpy.array([0 if cell is None else cell for cell in wanted], dtype=kind)
    bits = f"u{kind.itemsize}"
    got = numpy.ascontiguousarray(got)
    differ = (got.view(bits) != wanted.view(bits)) & ~empty
    if differ.any():
        i = int(numpy.argmax(differ))
        raise AssertionError(f"{reader}: {name} differs in {differ.sum()} rows, first in row {i}: {got[i]!r} != {wanted[i]!r}")


def plain(text):
    """A text as XML 1.0 can hold it."""
    return "".join("\ufffd" if ord(c) < 32 and c not in "\t\n\r" else c for c in text)


def check_parquet(path, run):
    table = pyarrow.parquet.read_table(path)
    assert table.column_names == list(run.columns), table.column_names
    for field in table.schema:
        assert field.metadata[b"unit"].decode() == UNITS[field.name], field
        assert field.metadata[b"description"], field
        assert field.nullable == (field.name in NULLABLE), field
    check_facts({key.decode(): text.decode() for key, text in table.schema.metadata.items()}, run)
    keys = duckdb.sql(f"SELECT decode(key), decode(value) FROM parquet_kv_metadata('{path}')").fetchall()
    check_facts(dict(keys), run)
    frame = pandas.read_parquet(path, dtype_backend="pyarrow")
    polar = polars.read_parquet(path)
    duck = duckdb.sql(f"SELECT * FROM '{path}'").fetchnumpy()
    assert list(frame.columns) == polar.columns == list(duck) == list(run.columns)
    for name, wanted in run.columns.items():
        column = frame[name]
        kind = TYPES.get(name, "float64")
        same(name, column.fillna(0).to_numpy(dtype=None).astype(kind), column.isna().to_numpy(), wanted, "pandas")
        column = polar[name]
        same(name, column.fill_null(0).to_numpy(), column.is_null().to_numpy(), wanted, "Polars")
        column = duck[name]
        same(name, numpy.ma.getdata(column), numpy.ma.getmaskarray(column), wanted, "DuckDB")


def check_facts(facts, run):
    header = run.header
    for key in ("run_id", "started_utc", "specimen", "operator", "profile_toml", "bench_toml", "bench_sha256", "twin",
                "program_version"):
        assert facts[key] == header[key], f"{key}: {facts[key]!r}"
    assert hashlib.sha256(header["bench_toml"].encode()).hexdigest() == facts["bench_sha256"]
    assert hashlib.sha256(run.path.read_bytes()).hexdigest() == facts["run_file_sha256"]
    assert int(facts["calibration_hash"], 16) == header["firmware"]["calibration_hash"]
    calibration = json.loads(facts["calibration"])
    for column, name in (("force_n", "force"), ("displacement_mm", "displacement")):
        # The scale with the identity of the sensor (serial number, certificate), where the bench states one.
        sensor = {key: value for key, value in header.get(f"{name}_sensor", {}).items() if value != ""}
        assert calibration[column] == {**header[f"{name}_channel"], **sensor}, calibration[column]
    assert float(facts["sample_rate_hz"]) == header["sample_rate_hz"]
    details = json.loads(facts["leafbench"])
    assert details["outcome"] == run.outcome and details["run_id"] == header["run_id"]


def check_mf4(path, run):
    check_blocks(path.read_bytes())
    header = run.header
    with MDF(path) as mdf:
        assert mdf.version == "4.10" and len(mdf.groups) == 1, (mdf.version, len(mdf.groups))
        group = mdf.groups[0]
        assert [channel.name for channel in group.channels] == list(run.columns)
        assert mdf.masters_db == {0: 0}, mdf.masters_db
        masters = [channel.name for channel in group.channels if channel.channel_type == 2]
        assert masters == ["time_s"] and group.channels[0].sync_type == 1, masters
        assert group.channel_group.cycles_nr == run.rows
        same("time_s", mdf.get_master(0), numpy.zeros(run.rows, bool), run.columns["time_s"], "asammdf")
        for channel in group.channels:
            name, signal = channel.name, mdf.get(channel.name, ignore_invalidation_bits=True)
            assert channel.unit == signal.unit == UNITS[name], (name, channel.unit)
            assert channel.comment and "<" not in channel.comment, channel.comment
            invalid = signal.invalidation_bits
            missing = numpy.zeros(run.rows, bool) if invalid is None else numpy.asarray(invalid).astype(bool)
            same(name, signal.samples, missing, run.columns[name], "asammdf")
            if name in NULLABLE:
                assert numpy.isnan(signal.samples[missing]).all(), f"{name} has a number where it has no value"
        check_properties(mdf, run)
        attachments = {str(a.file_name): (i, a) for i, a in enumerate(mdf.attachments)}
        details = attachments.pop("leafbench.json")
        assert json.loads(mdf.extract_attachment(details[0])[0])["outcome"] == run.outcome
        for name, key in (("profile.toml", "profile_toml"), ("bench.toml", "bench_toml")):
            index, block = attachments.pop(name)
            data, _, md5 = mdf.extract_attachment(index)
            assert data == header[key].encode(), f"{name} is not what was used"
            assert md5 == hashlib.md5(data).digest() == block.md5_sum, name
        assert not attachments, attachments
        told = [(time_s, kind, text) for time_s, kind, text in run.events if kind != "correction"]
        assert [(e.name, e.comment) for e in mdf.events] == [(kind, text) for _, kind, text in told]
        for event, (time_s, _, _) in zip(mdf.events, told):
            assert abs(event.value - time_s) < 1e-9, (event.value, time_s)


def check_properties(mdf, run):
    header = run.header
    started = datetime.fromisoformat(header["started_utc"].replace("Z", "+00:00"))
    assert mdf.header.start_time == started, (mdf.header.start_time, started)
    assert mdf.header.author == plain(header["operator"]) and mdf.header.subject == plain(header["specimen"])
    found = mdf.header._common_properties
    for key in ("run_id", "specimen", "operator", "bench_sha256", "program_version", "twin"):
        assert found.get(key, "") == plain(header[key]), (key, found.get(key))
    assert int(found["calibration_hash"], 16) == header["firmware"]["calibration_hash"]
    assert found["run_file_sha256"] == hashlib.sha256(run.path.read_bytes()).hexdigest()


def check_blocks(data):
    """Every block begins at a multiple of 8 bytes, right after the one before it, and every link leads to a block."""
    at, blocks, links = 64, set(), set()
    while at < len(data):
        mark, length, count = struct.unpack_from("<4s4xQQ", data, at)
        assert mark[:2] == b"##" and at % 8 == 0, f"no block at {at}"
        blocks.add(at)
        links.update(struct.unpack_from(f"<{count}Q", data, at + 24))
        end = at + length
        at = (end + 7) // 8 * 8
        assert not any(data[end:at]), f"the filling after {end} is not zero"
    assert end == len(data), f"the last block ends at {end}, the file at {len(data)}"
    assert links - {0} <= blocks, f"links to no block: {links - {0} - blocks}"


def check_csv(path, run):
    """The CSV is rounded: half a unit of its last digit at most."""
    with open(path, newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == list(run.columns), rows[0]
    assert len(rows) - 1 == run.rows
    for name, cells in zip(rows[0], zip(*rows[1:])):
        for cell, wanted in zip(cells, run.columns[name]):
            if wanted is None:
                assert cell == "", (name, cell)
                continue
            digits = len(cell.partition(".")[2])
            # A unit of the last place of the double is more than the digits of a huge number.
            near = 0.500001 * 10.0**-digits + math.ulp(wanted)
            assert abs(float(cell) - wanted) <= near, (name, cell, wanted)


def check_mean_loop(parquet, mf4, source):
    """Both have the same bits, and those of the CSV to its last digit."""
    frame = polars.read_parquet(parquet)
    with open(source, newline="") as file:
        rows = list(csv.reader(file))
    assert frame.columns == rows[0] and frame.height == len(rows) - 1 > 0
    with MDF(mf4) as mdf:
        for name, cells in zip(rows[0], zip(*rows[1:])):
            numbers = frame[name].to_list()
            same(name, mdf.get(name, ignore_invalidation_bits=True).samples, numpy.array([n is None for n in numbers]),
                 numbers, "asammdf")
            for number, cell in zip(numbers, cells):
                assert (number is None) == (cell == ""), (name, number, cell)
                digits = len(cell.partition(".")[2])
                assert number is None or abs(number - float(cell)) <= 0.500001 * 10.0**-digits, (name, number, cell)


# ---- the run file's description

def check_document(run):
    """The Python program of the document prints what is in the run file."""
    lines = DOCUMENT.read_text().splitlines()
    begin = next(i for i, line in enumerate(lines) if line.strip() == "import json, sqlite3, struct, zlib")
    end = next(i for i, line in enumerate(lines[begin:], begin) if line and not line.startswith("    "))
    program = "\n".join(line[4:] for line in lines[begin:end]).replace("RUN.leafrun", str(run.path))
    printed = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    wanted = zip(*(run.columns[name] for name in ("time_s", "displacement_mm", "force_n")))
    assert printed.splitlines() == [" ".join(map(str, row)) for row in wanted]


def export(leafbench, run, folder, *options, code=0):
    done = subprocess.run([leafbench, "export", run, "--json", "--out", folder, *options], capture_output=True, text=True)
    assert done.returncode == code, f"export {options} of {run} ended with {done.returncode}: {done.stdout}{done.stderr}"
    return {key: pathlib.Path(name) for key, name in json.loads(done.stdout).items() if isinstance(name, str)}


def check_run(leafbench, path, folder, code=0):
    files = export(leafbench, path, folder, "--format", "csv,mf4,parquet", code=code)
    run = Run(path)
    check_csv(files["csv"], run)
    check_parquet(files["parquet"], run)
    check_mf4(files["mf4"], run)
    empty = {name: sum(cell is None for cell in cells) for name, cells in run.columns.items()}
    print(f"{path.name}: {run.rows} rows, {len(run.columns)} columns, {sum(empty.values())} empty cells, the same in all readers")
    return run, empty


def main():
    leafbench = str(pathlib.Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as name:
        work = pathlib.Path(name)
        demo = pathlib.Path(sys.argv[2]) if len(sys.argv) > 2 else work / "demo"
        if len(sys.argv) <= 2:
            subprocess.run([leafbench, "demo", "--out", demo], check=True, stdout=subprocess.DEVNULL)
        ramp, _ = check_run(leafbench, demo / "static-ramp.leafrun", work / "ramp")
        assert "command_n" in ramp.columns and ramp.rows > 120_000
        sine, _ = check_run(leafbench, demo / "sine-6mm-1hz.leafrun", work / "sine")
        assert "command_mm" in sine.columns and max(sine.columns["cycle"]) == 50
        check_document(sine)
        damaged, _ = check_run(leafbench, damaged_run(sine.path, work), work / "damaged", code=1)
        assert 0 < damaged.rows < sine.rows
        _, empty = check_run(leafbench, awkward_run(sine.path, work), work / "awkward")
        assert all(empty[name] > 100 for name in NULLABLE), empty
        both = ("--format", "mf4,parquet")
        files = export(leafbench, sine.path, work / "cycle", *both, "--cycle", "3")
        cycle = sine.part(lambda i: sine.columns["cycle"][i] == 3)
        assert cycle.rows == 1000 and set(files) == {"mf4", "parquet"}, files
        check_parquet(files["parquet"], cycle)
        check_mf4(files["mf4"], cycle)
        files = export(leafbench, sine.path, work / "mean", "--format", "mf4,parquet,csv", "--mean-loop")
        check_mean_loop(files["parquet"], files["mf4"], files["csv"])
    print("asammdf, pandas, Polars and DuckDB read what the run file holds")


if __name__ == "__main__":
    main()
