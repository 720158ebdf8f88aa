"""Checks of arguments: each returns the value in the type that the compiled half takes, or raises with what to give instead."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from ._errors import ArgumentTypeError, InputError

#: Benches, profiles and specimens that come with the package.
CONFIGS = Path(__file__).parent / "configs"


def _got(value: object) -> str:
    return type(value).__name__


def text(name: str, value: object) -> str:
    """A text without zero bytes, which no file name and no TOML has."""
    if not isinstance(value, str):
        raise ArgumentTypeError(f"{name} is a {_got(value)}: give a text (str)")
    if "\0" in value:
        raise InputError(f"{name} has a zero byte: remove it")
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{name} is no Unicode text: {error.reason}: correct the character at {error.start}") from None
    return value


def text_or_none(name: str, value: object) -> str | None:
    return None if value is None else text(name, value)


def path(name: str, value: object) -> str:
    """A path of a file."""
    if not isinstance(value, (str, os.PathLike)):
        raise ArgumentTypeError(f"{name} is a {_got(value)}: give a path (str or pathlib.Path)")
    given = os.fspath(value)
    if isinstance(given, bytes):
        given = os.fsdecode(given)
    if not given:
        raise InputError(f"{name} is empty: give a path")
    if "\0" in given:
        raise InputError(f"{name} has a zero byte: remove it")
    try:
        os.fsencode(given)
    except UnicodeEncodeError as error:
        raise InputError(f"{name} is no file name: {error.reason}: correct the character at {error.start}") from None
    return given


def word_or_path(name: str, value: object) -> str:
    """The name of a shipped file, the path of a file or its text."""
    if isinstance(value, os.PathLike):
        value = path(name, value)
    if not isinstance(value, str):
        raise ArgumentTypeError(
            f"{name} is a {_got(value)}: give the name of a shipped one, a path of a .toml file, or the text of one"
        )
    given = text(name, value)
    if not given.strip():
        raise InputError(f"{name} is empty: give the name of a shipped one, a path of a .toml file, or the text of one")
    return given


def whole(name: str, value: object, least: int, most: int) -> int:
    """A whole number within a range."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise ArgumentTypeError(f"{name} is a {_got(value)}: give a whole number from {least} to {most}")
    if not least <= int(value) <= most:
        raise InputError(f"{name} {value} is out of range: give a whole number from {least} to {most}")
    return int(value)


def switch(name: str, value: object) -> bool:
    """True or False and nothing that only counts as such."""
    if not isinstance(value, bool):
        raise ArgumentTypeError(f"{name} is a {_got(value)}: give True or False")
    return value


def items(name: str, value: Iterable[Any]) -> Iterator[Any]:
    """The items one by one; some things say that they have items and do not, such as a numpy array without a dimension."""
    try:
        return iter(value)
    except TypeError as error:
        raise ArgumentTypeError(f"{name} is a {_got(value)} without items ({error}): give a list") from error


def texts(name: str, value: object) -> list[str]:
    """A sequence of texts. A single text is refused, because it would be taken for its letters."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise ArgumentTypeError(f"{name} is a {_got(value)}: give a list of texts")
    return [text(f"{name}[{index}]", item) for index, item in enumerate(items(name, value))]


def numbers_by_name(name: str, value: object) -> list[tuple[str, float]]:
    """A mapping of names to finite numbers."""
    if not isinstance(value, Mapping):
        raise ArgumentTypeError(f"{name} is a {_got(value)}: give a dict of names and numbers")
    pairs = []
    for key, number in value.items():
        place = f'{name}["{text(f"a name in {name}", key)}"]'
        if isinstance(number, bool) or not isinstance(number, Real):
            raise ArgumentTypeError(f"{place} is a {_got(number)}: give a number")
        try:
            as_float = float(number)
        except OverflowError:
            as_float = float("inf")
        if as_float - as_float != 0.0:
            raise InputError(f"{place} is not a finite number: give one")
        pairs.append((key, as_float))
    return pairs


def progress(value: object) -> Callable[[float, str], Any] | None:
    """A function of share and step, or none."""
    if value is not None and not callable(value):
        raise ArgumentTypeError(f"progress is a {_got(value)}: give a function of two arguments, share (0 to 1) and step (str)")
    return value
