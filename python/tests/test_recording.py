"""Recordings: columns, views of their memory, mistakes with their place."""

from __future__ import annotations

import pickle

import numpy as np
import pandas
import polars
import pyarrow
import pytest
from conftest import loops

import leafbench
from leafbench import ArgumentTypeError, InputError, Recording


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def test_a_recording_keeps_its_numbers_and_its_arrays_cannot_be_written():
    time_s = [0.0, 0.5, 1.0]
    recording = Recording(
        time_s, [1, 2, 3], np.float32([4, 5, 6]), command_n=[None, 2.0, 3.0], cycle=[0, 1, 1], flags=[0, 0, 65535], name="a"
    )
    assert recording.columns == ("time_s", "displacement_mm", "force_n", "command_n", "cycle", "flags")
    assert recording.time_s.tolist() == time_s
    assert recording.force_n.dtype == np.float64 and recording.force_n.tolist() == [4.0, 5.0, 6.0]
    assert np.isnan(recording["command_n"][0]) and recording.command_mm is None
    assert recording.cycle.dtype == np.uint32 and recording.flags[2] == 65535
    assert len(recording) == 3 and "'a'" in repr(recording)
    with pytest.raises(ValueError, match="read-only"):
        recording.force_n[0] = 1.0
    with pytest.raises(KeyError, match="use one of time_s"):
        recording["force"]


def test_numpy_arrow_polars_and_pandas_read_the_same_memory():
    recording = loops()
    at = address(recording.force_n)
    assert address(recording.force_n) == at
    table = recording.to_arrow()
    assert table.column("force_n").chunk(0).buffers()[1].address == at
    assert table.schema.field("force_n").metadata == {b"unit": b"N"}
    assert address(recording.to_polars()["force_n"].to_numpy(allow_copy=False)) == at
    frame = recording.to_pandas()
    assert address(frame["force_n"].to_numpy()) == at
    assert list(frame) == list(recording.columns)


def test_the_memory_lives_as_long_as_its_readers():
    expected = loops().force_n.copy()
    readers = [np.asarray(loops().force_n), loops().to_arrow()["force_n"], loops().to_polars()["force_n"]]
    junk = [np.ones(2000) for _ in range(50)]
    for reader in readers:
        assert np.array_equal(np.asarray(reader), expected)
    assert len(junk) == 50


def test_a_row_without_a_command_is_null_in_arrow():
    recording = Recording([0, 1], [0, 1], [0, 1], command_mm=[np.nan, 1])
    assert recording.to_arrow()["command_mm"].to_pylist() == [None, 1.0]
    assert recording.to_polars()["command_mm"].null_count() == 1


@pytest.mark.parametrize("convert", [Recording.to_pandas, Recording.to_polars, Recording.to_arrow, lambda r: {c: r[c] for c in r.columns}])
def test_tables_come_back(convert):
    recording = leafbench.simulate("sine-6mm-2.5hz-10")
    again = Recording.from_table(convert(recording), name=recording.name)
    assert again.columns == recording.columns
    for column in recording.columns:
        assert np.array_equal(again[column], recording[column], equal_nan=True), column


def test_a_table_may_have_more_columns_and_two_of_commands():
    table = {"time_s": [0, 1], "displacement_mm": [0, 1], "force_n": [0, 1], "note": ["a", "b"]}
    assert Recording.from_table(table).columns == ("time_s", "displacement_mm", "force_n")
    commands = {"command_mm": [np.nan, 1.0], "command_n": [5.0, np.nan]}
    assert Recording.from_table(table | commands).columns[-1] == "command_n"


def test_a_recording_can_be_pickled_and_flipped():
    recording = loops(name="a")
    again = pickle.loads(pickle.dumps(recording))
    assert again.name == "a" and np.array_equal(again.force_n, recording.force_n)
    flipped = recording.flipped(force=True)
    assert np.array_equal(flipped.force_n, -recording.force_n)
    assert np.array_equal(flipped.displacement_mm, recording.displacement_mm)


SOUND = {"time_s": [0.0, 1.0, 2.0], "displacement_mm": [0.0, 1.0, 2.0], "force_n": [0.0, 1.0, 2.0]}
MISTAKES = [
    ({"force_n": [0.0, np.nan, 2.0]}, "force_n", 1, "nan is not a finite number|NaN is not a finite number"),
    ({"displacement_mm": [0.0, 1.0, np.inf]}, "displacement_mm", 2, "not a finite number"),
    ({"force_n": [0.0, 1.0]}, "force_n", None, "it has 2 values and time_s has 3"),
    ({"time_s": [0.0, 1.0, 1.0]}, "time_s", 2, "time must rise"),
    ({"time_s": [], "displacement_mm": [], "force_n": []}, "time_s", None, "no samples"),
    ({"force_n": [[0.0, 1.0, 2.0]]}, "force_n", None, r"shape \(1, 3\)"),
    ({"force_n": 3.0}, "force_n", None, r"shape \(\)"),
    ({"force_n": ["0", "1", "2"]}, "force_n", None, "type <U1"),
    ({"force_n": [0.0, None, 2.0]}, "force_n", 1, "None is no number"),
    ({"force_n": [0j, 1j, 2j]}, "force_n", None, "type complex128"),
    ({"force_n": [[0.0], [1.0, 2.0]]}, "force_n", None, "give a list or an array of numbers"),
    ({"cycle": [0, 1, -1]}, "cycle", 2, "whole number from 0 to 4294967295"),
    ({"cycle": [0, 0.5, 1]}, "cycle", 1, "whole number"),
    ({"flags": [0, np.nan, 1]}, "flags", 1, "whole number from 0 to 65535"),
    ({"flags": [0, 65536, 1]}, "flags", 1, "65536 is no whole number"),
    ({"command_mm": [0, np.inf, 1]}, None, None, None),
]


@pytest.mark.parametrize(("change", "column", "index", "words"), MISTAKES)
def test_each_mistake_is_named_with_its_column_and_index(change, column, index, words):
    if words is None:
        # A command may be anything; it is not fitted to.
        assert len(Recording(**SOUND | change)) == 3
        return
    with pytest.raises(InputError, match=words) as raised:
        Recording(**SOUND | change, name="run 7")
    assert isinstance(raised.value, ValueError)
    assert (raised.value.file, raised.value.column, raised.value.index) == ("run 7", column, index)
    assert str(raised.value).startswith(f"run 7, column {column}")


def test_both_commands_a_dict_as_column_and_a_table_without_force_are_refused():
    with pytest.raises(InputError, match="give the one that the rig controlled"):
        Recording(**SOUND, command_mm=[0] * 3, command_n=[0] * 3)
    with pytest.raises(ArgumentTypeError, match="it is a dict"):
        Recording(**SOUND | {"force_n": {"a": 1}})
    with pytest.raises(InputError, match="no column force_n: rename") as raised:
        Recording.from_table(pandas.DataFrame({"time_s": [0], "displacement_mm": [0], "Kraft": [0]}))
    assert raised.value.column == "force_n"
    with pytest.raises(ArgumentTypeError, match="give a data frame"):
        Recording.from_table(7)


def test_more_samples_than_fit_are_refused_before_they_are_copied():
    huge = np.broadcast_to(np.float64(0), (10**12,))
    with pytest.raises(InputError, match="at most 50000000"):
        Recording(huge, huge, huge)


def test_arrow_arrays_and_series_are_columns():
    recording = Recording(pyarrow.array([0.0, 1.0]), polars.Series([0.0, 1.0]), pandas.Series([0.0, 1.0]))
    assert recording.force_n.tolist() == [0.0, 1.0]
