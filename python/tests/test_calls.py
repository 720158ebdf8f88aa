"""What the commands do, as functions: results, typed as in diagnosis.json, and mistakes."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import SLOW, loops, sine

import leafbench
from leafbench import ArgumentTypeError, InputError, Recording, fleet

FORMATS = Path(__file__).resolve().parents[2] / "docs/formats.md"


@pytest.fixture(scope="module")
def diagnosis(measured, helper_leaf_bench):
    steps = []
    found = leafbench.diagnose(
        measured[0], left_out=measured[1:], bench=helper_leaf_bench, progress=lambda share, step: steps.append((share, step))
    )
    assert steps and all(0 <= share <= 1 and step for share, step in steps)
    return found


def test_a_concealed_helper_leaf_is_named(diagnosis):
    assert diagnosis.verdict == "missing_physics" and str(diagnosis) == diagnosis.summary
    assert [finding.code for finding in diagnosis.effects] == ["progressive_stiffness"]
    finding = diagnosis.effects[0]
    values = {value.name: value for value in finding.parameters}
    low, high = values["knee_mm"].ci95
    assert low < values["knee_mm"].value < high and abs(values["knee_mm"].value - 8.0) < 0.5
    assert 0.5 < finding.confidence <= 0.99
    assert diagnosis.fit.improved.nrmse_heldout < 0.5 * diagnosis.fit.baseline.nrmse_heldout
    assert diagnosis.left_out[0].recording == "quick"
    assert len(repr(diagnosis)) < 20_000


def test_the_improved_bench_is_one_to_simulate_with(diagnosis, measured):
    assert diagnosis.proof.written
    simulated = leafbench.simulate(SLOW, bench=diagnosis.improved_toml)
    peak_n = simulated.force_n.max()
    assert abs(peak_n - measured[0].force_n.max()) < 0.02 * peak_n


def test_the_fields_are_those_of_diagnosis_json(diagnosis):
    """No key of the JSON is lost, and every field that the document lists is there."""

    def compare(value, given, place):
        if dataclasses.is_dataclass(value):
            for key, inner in given.items():
                compare(getattr(value, "from_" if key == "from" else key), inner, f"{place}.{key}")
        elif isinstance(value, tuple):
            assert len(value) == len(given), place
            for index, (one, other) in enumerate(zip(value, given)):
                compare(one, other, f"{place}[{index}]")
        elif isinstance(value, dict) and isinstance(given, list):
            assert list(value.items()) == [tuple(pair) for pair in given], place
        elif given is None:
            assert value is None or math.isnan(value), place
        else:
            assert value == given, place

    compare(diagnosis, json.loads(diagnosis.json), "diagnosis")
    section = FORMATS.read_text().split("### `diagnosis.json`")[1].split("With `--targets`")[0]
    documented = set(re.findall(r"^\| `(\w+)", section.split("#### Notes")[0], re.M))
    ours = {field.name for field in dataclasses.fields(leafbench.Diagnosis)} - {"json", "improved_toml"}
    assert documented == ours, documented ^ ours


def test_results_are_frozen(diagnosis):
    with pytest.raises(dataclasses.FrozenInstanceError):
        diagnosis.verdict = "adequate"


def test_a_sound_spring_needs_nothing():
    found = leafbench.diagnose([leafbench.simulate(SLOW, rig=True)])
    assert found.verdict == "adequate" and not found.effects


def test_simulate_gives_what_the_model_says():
    recording = leafbench.simulate("static-ramp-12s")
    assert recording.command_n is not None and abs(recording.force_n.max() - 2000) < 1
    assert recording.name == "static-ramp-12s" and recording.specimen
    noisy = [leafbench.simulate(SLOW, rig=True, seed=seed).force_n for seed in (7, 7, 8)]
    assert np.array_equal(noisy[0], noisy[1]) and not np.array_equal(noisy[0], noisy[2])


def test_plan_tells_the_margins_and_trips():
    plan = leafbench.plan("static-ramp-12s", bench="mock")
    assert plan.may_run and plan.duration_s >= 12 and any(m.limit == "force_max_n" for m in plan.margins)
    broken = leafbench.plan(sine("deep", 500.0, 0.1, 1))
    assert not broken.may_run and any("displacement_max_mm" in trip for trip in broken.trips)


def test_identify_finds_the_rate_and_writes_a_specimen(tmp_path):
    found = leafbench.identify(loops(), model="equivalent", fix={"preload_n": 0.0}, begin="rest")
    rate = found["rate_n_per_mm"]
    assert found.converged and rate.free and abs(rate.value - 80) < 0.5 and rate.unit == "N/mm"
    assert not found["preload_n"].free and found.errors[0].of == "loops"
    with pytest.raises(KeyError, match="use one of preload_n"):
        found["rate"]
    path = tmp_path / "found.toml"
    path.write_text(found.specimen_toml)
    again = leafbench.identify(loops(), specimen=path, free=["rate_n_per_mm"])
    assert abs(again["rate_n_per_mm"].value - rate.value) < 0.5


def test_lists_of_names():
    assert "equivalent" in leafbench.models() and "backlash" in leafbench.physics()
    assert "mock" in leafbench.benches() and "static-ramp" in leafbench.profiles()
    for name in leafbench.profiles():
        assert leafbench.plan(name).profile == name


FRAME = {"time_s": [0.0, 1.0], "displacement_mm": [0.0, 1.0], "force_n": [0.0, 1.0]}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: leafbench.diagnose(loops(), baseline="equivalant"), "did you mean equivalent"),
        (lambda: leafbench.diagnose(loops(), known=["backlsh"]), "did you mean backlash"),
        (lambda: leafbench.diagnose(loops(), bench="samurai-rial"), "did you mean samurai-rail"),
        (lambda: leafbench.simulate("static-rmap"), "did you mean static-ramp"),
        (lambda: leafbench.identify(loops(), model="equivalant"), "did you mean equivalent"),
        (lambda: leafbench.identify(loops(), model="equivalent", fix={"rate_n_per_m": 1.0}), "did you mean rate_n_per_mm"),
        (lambda: leafbench.identify(loops(), model="equivalent", method="least-sqares"), "did you mean least-squares"),
        (lambda: leafbench.identify(loops()), "give model=NAME or specimen=FILE"),
        (lambda: leafbench.identify(loops(), model="equivalent", seed=-1), "seed -1 is out of range"),
        (lambda: leafbench.identify(loops(), model="equivalent", fix={"preload_n": math.nan}), "not a finite number"),
        (lambda: leafbench.diagnose([]), "give at least one recording"),
        (lambda: leafbench.diagnose(loops(), bench=""), "bench is empty"),
        (lambda: leafbench.diagnose(loops(), threads=257), "from 0 to 256"),
        (lambda: leafbench.simulate("static-ramp", seed=3), "add rig=True"),
        (lambda: leafbench.simulate("name = 3\n"), "line 1, column 8"),
        (lambda: leafbench.diagnose(loops(samples=5)), "loops"),
    ],
)
def test_a_mistake_is_an_input_error_that_says_what_to_do(call, words):
    with pytest.raises(InputError, match=words) as raised:
        call()
    assert isinstance(raised.value, ValueError) and "--" not in str(raised.value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: leafbench.diagnose(FRAME), "recordings is a dict and no recording: make one with leafbench.Recording.from_table"),
        (lambda: leafbench.diagnose([FRAME]), r"recordings\[0\] is a dict"),
        (lambda: leafbench.diagnose(loops().to_pandas()), "is a DataFrame and no recording: make one"),
        (lambda: leafbench.diagnose(loops().to_polars()), "is a DataFrame and no recording: make one"),
        (lambda: leafbench.diagnose(loops().to_arrow()), "is a Table and no recording: make one"),
        (lambda: leafbench.diagnose(None), "recordings is a NoneType"),
        (lambda: leafbench.diagnose(loops(), known="backlash"), "known is a str: give a list of texts"),
        (lambda: leafbench.diagnose(loops(), threads=1.5), "threads is a float"),
        (lambda: leafbench.diagnose(loops(), progress=3), "progress is a int"),
        (lambda: leafbench.diagnose(loops(), mixed_specimens="no"), "give True or False"),
        (lambda: leafbench.simulate(3), "profile is a int"),
        (lambda: leafbench.simulate("static-ramp", rig=np.zeros(0)), "rig is a ndarray: give True or False"),
        (lambda: leafbench.simulate("static-ramp", rig=np.zeros(0), seed=0), "rig is a ndarray: give True or False"),
        (lambda: fleet.diagnose("absent", engine=np.zeros(3)), "engine is a ndarray"),
        (lambda: fleet.diagnose("absent", estimates_only=np.zeros(0)), "estimates_only is a ndarray: give True or False"),
        (lambda: fleet.diagnose("absent", address=3), "address is a int"),
        (lambda: fleet.diagnose("absent", progress=3), "progress is a int"),
        (lambda: leafbench.identify(loops(), model="equivalent", fix=["preload_n"]), "fix is a list"),
    ],
)
def test_a_wrong_type_is_a_value_error_and_a_type_error(call, words):
    with pytest.raises(ArgumentTypeError, match=words) as raised:
        call()
    assert isinstance(raised.value, ValueError) and isinstance(raised.value, TypeError)


def test_a_wrong_path_is_an_os_error(tmp_path):
    for call in (
        lambda: leafbench.diagnose(tmp_path / "absent.csv"),
        lambda: leafbench.diagnose(loops(), bench=tmp_path / "absent.toml"),
        lambda: leafbench.simulate(tmp_path / "absent.toml"),
        lambda: leafbench.identify(loops(), specimen=tmp_path / "absent.toml"),
    ):
        with pytest.raises(FileNotFoundError):
            call()


def test_recordings_of_two_specimens_are_refused_unless_they_are_allowed():
    def of(specimen):
        one = loops(name=specimen)
        return Recording(one.time_s, one.displacement_mm, one.force_n, name=specimen, specimen=specimen)

    both = [of("leaf 7"), of("leaf 8")]
    with pytest.raises(InputError, match="add mixed_specimens=True"):
        leafbench.diagnose(both)
    assert leafbench.diagnose(both, mixed_specimens=True).verdict


def test_a_column_in_kilonewtons_and_a_turned_sign_are_refused(measured):
    slow = measured[0]
    with pytest.raises(InputError, match="kilonewtons"):
        leafbench.diagnose(Recording(slow.time_s, slow.displacement_mm, slow.force_n / 1000))
    with pytest.raises(InputError, match=r"recording\.flipped\(force=True\)"):
        leafbench.diagnose(slow.flipped(force=True))


def test_a_key_of_a_bench_that_is_wrong_has_its_line():
    with pytest.raises(InputError) as raised:
        leafbench.plan("static-ramp", bench='name = "a"\nlimit = 3\n')
    assert raised.value.row and raised.value.column
