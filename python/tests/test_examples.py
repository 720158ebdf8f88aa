"""The examples run, and find what is there to find."""

from __future__ import annotations

import doctest
import runpy
import sys
from pathlib import Path

import pytest

import leafbench

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name, monkeypatch):
    monkeypatch.setattr(sys, "argv", [name])
    return runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_cycles_in_a_data_frame(monkeypatch):
    found = run("cycles_in_a_data_frame.py", monkeypatch)
    assert found["cycles"].height == 10
    # 6 mm sine of a spring with 15 % friction: the travel is twice the amplitude.
    assert found["cycles"]["travel_mm"].is_between(11.8, 12.2).all()
    assert found["spread_percent"] < 2


def test_missing_physics(monkeypatch):
    found = run("missing_physics.py", monkeypatch)
    assert [finding.code for finding in found["diagnosis"].effects] == ["progressive_stiffness"]
    assert abs(found["error_share"]) < 0.02


def test_fit_a_spring(monkeypatch, capsys):
    found = run("fit_a_spring.py", monkeypatch)["found"]
    low, high = found["rate_n_per_mm"].ci95
    assert low < 80 < high and abs(found["friction_ratio"].value - 0.12) < 0.005
    assert "the place: column force_n, index 3" in capsys.readouterr().out


def test_the_example_of_the_document(capsys):
    text = (Path(__file__).resolve().parents[2] / "docs/python.md").read_text()
    names = {}
    exec(text.split("```python\n")[1].split("```")[0], names)
    assert names["diagnosis"].verdict and names["better"].force_n.max() > 1900
    assert str(names["diagnosis"]) in capsys.readouterr().out


def test_the_document_names_every_function():
    text = (Path(__file__).resolve().parents[2] / "docs/python.md").read_text()
    functions = [name for name in leafbench.__all__ if name[0].islower()]
    assert [name for name in functions if f"`{name}(" not in text] == []


def test_every_example_is_tested():
    tested = {name.removeprefix("test_") + ".py" for name in globals() if name.startswith("test_")}
    shown = {path.name for path in EXAMPLES.glob("*.py")}
    assert shown and shown <= tested


@pytest.mark.parametrize("module", ["leafbench", "leafbench._recording"])
def test_the_examples_in_docstrings_are_right(module):
    failed, tried = doctest.testmod(sys.modules[module], extraglobs={"Recording": leafbench.Recording})
    assert tried and not failed
