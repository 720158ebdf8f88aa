"""Exceptions. All that a wrong input can raise are subclasses of ValueError or OSError."""

from __future__ import annotations

from ._leafbench import InputError, InternalError

__all__ = ["ArgumentTypeError", "InputError", "InternalError"]

# The place of a mistake; a class attribute, so that every InputError has it.
for _place in ("file", "row", "column", "index"):
    setattr(InputError, _place, None)


class ArgumentTypeError(InputError, TypeError):
    """An argument of a wrong type: the text says which, and what to give instead. It is a ValueError and a TypeError."""


def input_error(
    text: str, *, file: str | None = None, column: str | None = None, index: int | None = None
) -> InputError:
    """An InputError with its place."""
    error = InputError(text)
    error.file, error.column, error.index = file, column, index
    return error
