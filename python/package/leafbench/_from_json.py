"""Frozen dataclasses from JSON: the annotations of the fields say what each value becomes."""

from __future__ import annotations

import dataclasses
import json
import types
from functools import cache
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")

#: Keys of JSON that are words of Python.
_PYTHON_NAMES = {"from": "from_"}


def from_json(kind: type[T], text: str, **more: object) -> T:
    """An object of the dataclass `kind`; `more` has fields that the JSON does not have."""
    made: T = _object(kind, json.loads(text) | more)
    return made


def objects(kind: type[T], given: list[dict[str, Any]]) -> tuple[T, ...]:
    """Objects of the dataclass `kind`."""
    return tuple(_object(kind, item) for item in given)


@cache
def _hints(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _object(kind: Any, given: dict[str, Any]) -> Any:
    """Keys that the dataclass does not have are left out; fields that the JSON leaves out have defaults."""
    hints = _hints(kind)
    names = {_PYTHON_NAMES.get(key, key): value for key, value in given.items()}
    return kind(**{name: _value(hints[name], value) for name, value in names.items() if name in hints})


def _value(hint: Any, value: Any) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        inner = next(argument for argument in arguments if argument is not type(None))
        return None if value is None else _value(inner, value)
    if origin is tuple:
        kinds = arguments[:1] * len(value) if arguments[-1] is ... else arguments
        return tuple(_value(inner, item) for inner, item in zip(kinds, value, strict=True))
    if origin is dict and isinstance(value, list):
        # A list of pairs.
        return {name: _value(arguments[1], item) for name, item in value}
    if dataclasses.is_dataclass(hint):
        return _object(hint, value)
    if hint is float:
        # JSON has no number that is not finite: it is null there.
        return float("nan") if value is None else float(value)
    return value
