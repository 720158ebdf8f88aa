"""Files: run files, CSV, and what is wrong with them."""

from __future__ import annotations

import json
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
