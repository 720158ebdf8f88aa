"""Files: run files, CSV, and what is wrong with them."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import leafbench
from leafbench import ArgumentTypeError, InputError

REPOSITORY = Path(__file__).resolve().parents[2]
HEADER = "time_s,displacement_mm,force_n\n"


def written(folder: Path, text: str, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_csv_is_read_with_the_specimen_of_its_data_package(tmp_path):
    path = written(tmp_path, "force_n,time_s,displacement_mm,cycle,note\n1,0,2,0,a\n3,0.5,4,1,b\n")
    recording = leafbench.read(path)
    assert recording.columns == ("time_s", "displacement_mm", "force_n", "cycle")
    assert recording.force_n.tolist() == [1.0, 3.0] and recording.specimen is None
    written(tmp_path, json.dumps({"leafbench": {"specimen": "leaf 7"}}), "a.datapackage.json")
    assert leafbench.read(str(path)).specimen == "leaf 7"


def test_a_run_file_is_read():
    recording = leafbench.read(REPOSITORY / "tests/recordings/version-1.leafrun")
    assert recording.specimen == 'leaf spring, "no. 7"' and len(recording) == 30
    assert np.all(np.diff(recording.time_s) > 0)


@pytest.mark.parametrize(
    ("rows", "row", "column"),
    [
        ("0,1,2\n1,2,high\n", 3, "force_n"),
        ("0,1,2\n\n0.5,,3\n", 4, "displacement_mm"),
        ("0,1,nan\n", 2, "force_n"),
        ("1,1,1\n0,1,1\n", 3, "time_s"),
    ],
)
def test_a_broken_row_has_file_row_and_column(tmp_path, rows, row, column):
    path = written(tmp_path, HEADER + rows)
    with pytest.raises(InputError) as raised:
        leafbench.read(path)
    error = raised.value
    assert (error.file, error.row, error.column) == (str(path), row, column)
    assert f"row {row}" in str(error) and column in str(error) and str(path) in str(error)


def test_a_missing_column_is_named(tmp_path):
    with pytest.raises(InputError, match="force_n"):
        leafbench.read(written(tmp_path, "time_s,displacement_mm,Kraft\n0,1,2\n"))


def test_a_wrong_path_is_an_os_error(tmp_path):
    for name in ("absent.csv", "absent.leafrun"):
        with pytest.raises(FileNotFoundError) as raised:
            leafbench.read(tmp_path / name)
        assert raised.value.filename == str(tmp_path / name)
    with pytest.raises(InputError, match="is a folder"):
        leafbench.read(tmp_path)
    for wrong in (7, None, b"", ["a.csv"]):
        with pytest.raises((ArgumentTypeError, InputError)):
            leafbench.read(wrong)
    with pytest.raises(InputError, match="zero byte"):
        leafbench.read("a\0.csv")


def test_a_file_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"a\.leafrun"):
        leafbench.read(written(tmp_path, "no database", "a.leafrun"))


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """An archive of one run, made by the program. CI says where the program is."""
    program = os.environ.get("LEAFBENCH_PROGRAM")
    if not program:
        pytest.skip("LEAFBENCH_PROGRAM does not name the program leafbench, which makes an archive")
    place = tmp_path_factory.mktemp("archive") / "lab"
    subprocess.run([program, "archive", place, REPOSITORY / "tests/recordings/version-1.leafrun"], check=True)
    return place


def test_a_run_of_an_archive_has_the_numbers_of_its_file(archive):
    (run,) = leafbench.archived_runs(archive)
    of_file = leafbench.read(REPOSITORY / "tests/recordings/version-1.leafrun")
    assert run.specimen == of_file.specimen and run.started_utc
    for given in (run, run.run_id, [run], iter([run.run_id])):
        (recording,) = leafbench.read_archive(archive, given)
        assert recording.name == run.run_id and recording.specimen == run.specimen
        for column in ("time_s", "displacement_mm", "force_n"):
            assert np.array_equal(recording[column], of_file[column])
    with pytest.raises(InputError, match="did you mean"):
        leafbench.read_archive(archive, run.run_id[:-1] + "~")
    sample = next(archive.rglob("samples/**/*.parquet"))
    sample.write_bytes(sample.read_bytes()[:-1] + b"x")
    with pytest.raises(InputError, match="not what was written"):
        leafbench.read_archive(archive, run)


def test_what_is_no_archive_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        leafbench.archived_runs(tmp_path / "absent")
    with pytest.raises(InputError, match="is not an archive"):
        leafbench.read_archive(tmp_path, "a")
    with pytest.raises(InputError, match="read_archive reads an archive"):
        leafbench.read(tmp_path)
    # Ten thousand million items would need 300 GB as a list.
    with pytest.raises(ArgumentTypeError, match=r"runs\[0\]"):
        leafbench.read_archive(tmp_path, np.broadcast_to(1.0, 10**10))
    with pytest.raises(ArgumentTypeError, match="runs is a int"):
        leafbench.read_archive(tmp_path, 7)
