"""The error tree. Every message states what was wanted, what came, and what to do; its numbers are attributes.

UndriftError
  InputError(ValueError)       the call or the data is wrong
    FileFormatError            a file is not what it should be
  CalibrationError             a fit cannot be trusted
    NotObservable              the data do not determine a parameter
    PoorFit                    they do, and the model does not describe them
    Implausible                they do, and the answer cannot be this device
  DriftRangeError              a temperature outside the tuning table
  AlignmentError               two recordings cannot be brought together
  RigError                     a rate table or device failed
    LinkError, RigTimeout, RigFault, LimitError
"""

from functools import cache
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

_UNIONS = (Union, UnionType)


class UndriftError(Exception):
    """Root of all errors undrift raises on purpose.

    Parameters
    ----------
    message : str
        What was wanted, what came, what to do: one line.
    **numbers : object
        The figures in the message, kept as attributes of the error.
    """

    def __init__(self, message: str, **numbers: object) -> None:
        super().__init__(message)
        self.numbers = numbers

    def __getattr__(self, name: str) -> object:
        try:
            return self.__dict__["numbers"][name]
        except KeyError:
            raise AttributeError(name) from None


class InputError(UndriftError, ValueError):
    """The call or the data is wrong."""


class FileFormatError(InputError):
    """A file is not what it should be."""


class CalibrationError(UndriftError):
    """A fit cannot be trusted."""


class NotObservable(CalibrationError):
    """The data do not determine a parameter; the message names it, and the recording that would."""


class PoorFit(CalibrationError):
    """The model does not describe the data."""


class Implausible(CalibrationError):
    """The fit is sharp and its answer cannot be this device."""


class DriftRangeError(UndriftError):
    """A temperature outside the tuning table."""


class AlignmentError(UndriftError):
    """Two recordings cannot be brought together in time or in space."""


class RigError(UndriftError):
    """A rate table or device failed."""


class LinkError(RigError):
    """The connection to a rig or device is lost or garbled."""


class RigTimeout(RigError):
    """A rig did not answer in time."""


class RigFault(RigError):
    """A rig reported a fault."""


class LimitError(RigError):
    """A move outside the rig's limits, refused before a byte is sent."""


def check_positive(settings: object, what: str, advice: str, *names: str) -> None:
    """Refuse settings of which a named number is not above 0 and finite; one that is None is left out."""
    for name in names:
        value = getattr(settings, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise InputError(f"{what}: wanted {name} above 0, got {value}; {advice}")


def check_choices(settings: Any, what: str) -> None:
    """Refuse settings with a field of a Literal type whose value is not one of its choices."""
    for name, choices in _choices_of(settings.__class__):
        check_choice(getattr(settings, name), choices, what, name)


def check_choice(value: object, choices: object, what: str, name: str) -> None:
    """Refuse a value that is not among choices: a Literal type, optional or not, or a tuple of values."""
    allowed = choices if isinstance(choices, tuple) else _values_of(choices)
    if not any(value is each or (type(value) is type(each) and value == each) for each in allowed):
        words = ", ".join("None" if each is None else repr(each) for each in allowed)
        raise InputError(f"{what}: `{name}` must be one of {words}, got {value!r}. Choose one of these.")


@cache
def _choices_of(cls: type) -> tuple[tuple[str, tuple[object, ...]], ...]:
    """Return the fields of a settings class that are choices, with their values."""
    return tuple((name, values) for name, hint in get_type_hints(cls).items() if (values := _values_of(hint)))


def _values_of(hint: object) -> tuple[object, ...]:
    """Return the values of a Literal type, with None if it is optional; nothing of any other type."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    values: tuple[object, ...] = ()
    for part in get_args(hint) if get_origin(hint) in _UNIONS else ():
        if part is type(None):
            values += (None,)
        elif part_values := _values_of(part):
            values += part_values
        else:
            return ()  # free values are allowed too
    return values
