"""The runs of an archive are diagnosed once, with the same table whatever diagnoses them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

from leafbench import InputError, _leafbench, fleet

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """An archive of three runs of different length on the mock rig, made by the program."""
    program = os.environ.get("LEAFBENCH_PROGRAM")
    if not program:
        pytest.skip("LEAFBENCH_PROGRAM does not name the program leafbench, which makes an archive")
    folder = tmp_path_factory.mktemp("archive")
    subprocess.run([program, "lab", "--out", folder / "lab", "--specimens", "8", "--runs", "8", "--seed", "7"], check=True)
    subprocess.run([program, "archive", folder / "archive", folder / "lab/runs"], check=True)
    return folder / "archive"


def copy_of(archive: Path, folder: Path) -> Path:
    return Path(shutil.copytree(archive, folder / "copy"))


def diagnoses(archive: Path) -> dict[str, bytes]:
    return {str(path.relative_to(archive)): path.read_bytes() for path in archive.glob("diagnoses/**/*.parquet")}


def rows(archive: Path) -> pl.DataFrame:
    return pl.read_parquet(archive / "diagnoses/**/*.parquet", hive_partitioning=True).sort("run_id", "kind", "quantity")


def test_any_number_of_workers_writes_the_same_bytes(archive, tmp_path):
    tables = []
    for workers in (1, 3):
        copy = copy_of(archive, tmp_path / str(workers))
        assert fleet.diagnose(copy, workers=workers, estimates_only=True) == 8
        tables.append(diagnoses(copy))
    assert tables[0] == tables[1] and len(tables[0]) == 8


def test_python_and_the_program_find_the_same(archive, tmp_path):
    """They are two builds: the last bits of a number may differ."""
    by_python = copy_of(archive, tmp_path / "python")
    by_program = copy_of(archive, tmp_path / "program")
    seen = []
    assert fleet.diagnose(by_python, workers=2, estimates_only=True, progress=lambda done, count: seen.append((done, count))) == 8
    assert seen == [(done, 8) for done in range(1, 9)]
    subprocess.run([os.environ["LEAFBENCH_PROGRAM"], "fleet", "diagnose", by_program, "--estimates-only"], check=True)
    one, other = rows(by_python), rows(by_program)
    numbers = ["estimate", "std_error", "form_error"]
    assert one.height > 100 and one.drop(numbers).equals(other.drop(numbers))
    for name in numbers:
        size = one.select(pl.max_horizontal(pl.col(name).abs(), "std_error")).to_series()
        assert ((one[name] - other[name]).abs() / size).drop_nulls().max() < 1e-9, name
        assert one[name].null_count() == other[name].null_count() < one.height


def test_an_interrupted_command_goes_on_where_it_was(archive, tmp_path):
    copy = copy_of(archive, tmp_path)
    first = _leafbench.undiagnosed_runs(str(copy), "equivalent")[0]
    row = _leafbench.diagnose_archived(str(copy), first, "equivalent", True)
    assert [_leafbench.store_diagnoses(str(copy), [row]) for _ in range(2)] == [1, 0]
    before = diagnoses(copy)
    assert fleet.diagnose(copy, workers=1, estimates_only=True) == 7
    assert len(diagnoses(copy)) == 8 and before.items() <= diagnoses(copy).items()
    assert fleet.diagnose(copy, estimates_only=True) == 0


def test_the_command_says_what_is_wrong(archive, tmp_path, capsys):
    assert fleet.main(["diagnose", str(tmp_path / "absent")]) == 2
    assert "absent" in capsys.readouterr().err
    assert fleet.main(["diagnose", str(archive), "--baseline", "equvalent"]) == 2
    assert "equivalent" in capsys.readouterr().err
    with pytest.raises(InputError, match='give "local" or "ray"'):
        fleet.diagnose(archive, engine="spark")
    with pytest.raises(InputError, match="is no diagnosis of a run"):
        _leafbench.store_diagnoses(str(archive), ["{}"])


def test_without_ray_the_engine_says_what_to_install(archive, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match="pip install"):
        fleet.diagnose(copy_of(archive, tmp_path), engine="ray")
