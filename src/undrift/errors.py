"""The error tree. Every message names the problem, the value that caused it and a remedy. Its numbers are attributes.

UndriftError
  InputError(ValueError)       the call or the data is wrong
    FileFormatError            a file has the wrong format or is damaged
  CalibrationError             a fit cannot be trusted
    NotObservable              the data do not determine a parameter
    PoorFit                    the model does not describe the data
    Implausible                the fit is precise, but its result is impossible for this device
  DriftRangeError              a temperature is outside the tuning table
  AlignmentError               two recordings cannot be aligned
  RigError                     a rate table or device failed
    LinkError, RigTimeout, RigFault, LimitError
"""

from functools import cache
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints


class UndriftError(Exception):
    """Root of all errors that undrift raises on purpose.

    Parameters
    ----------
    message : str
        One line: the problem, the value that caused it and a remedy.
    **numbers : object
        The numbers in the message, stored as attributes of the error.
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
    """A file has the wrong format or is damaged."""


class CalibrationError(UndriftError):
    """A fit cannot be trusted."""


class NotObservable(CalibrationError):
    """The data do not determine a parameter. The message names the parameter and a recording that determines it."""


class PoorFit(CalibrationError):
    """The model does not describe the data."""


class Implausible(CalibrationError):
    """The fit is precise, but its result is impossible for this device."""


class DriftRangeError(UndriftError):
    """A temperature is outside the tuning table."""


class AlignmentError(UndriftError):
    """Two recordings cannot be aligned in time or in space."""


class RigError(UndriftError):
    """A rate table or device failed."""


class LinkError(RigError):
    """The connection to a rig or device is lost or garbled."""


class RigTimeout(RigError):
    """A rig did not answer in time."""


class RigFault(RigError):
    """A rig reported a fault."""


class LimitError(RigError):
    """A move exceeds the limits of the rig. It is refused before a byte is sent."""


def check_positive(settings: object, what: str, advice: str, *names: str) -> None:
    """Raise InputError if a named number of the settings is not positive and finite. None is accepted."""
    for name in names:
        value = getattr(settings, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise InputError(f"{what}: `{name}` must be above 0, got {value}. {advice}.")


def check_type(value: object, kind: type | UnionType, where: str, advice: str = "") -> None:
    """Raise InputError if a value is not an instance of a class. ``where`` names the function and its parameter."""
    if not isinstance(value, kind):
        wanted = " or ".join(each.__name__ for each in (get_args(kind) or (kind,)) if each is not type(None))
        raise InputError(f"{where}: expected {wanted}, got {type(value).__name__}.{advice and ' '}{advice}")


def check_choices(settings: Any, what: str) -> None:
    """Raise InputError if a field of a Literal type has a value outside its choices."""
    for name, choices in _choices_of(settings.__class__):
        check_choice(getattr(settings, name), choices, what, name)


def check_choice(value: object, choices: object, what: str, name: str) -> None:
    """Raise InputError if a value is not among the choices, given as a Literal type (optional or not) or a tuple of values."""
    allowed = choices if isinstance(choices, tuple) else _values_of(choices)
    if not any(value is choice or (type(value) is type(choice) and value == choice) for choice in allowed):
        listing = ", ".join("None" if choice is None else repr(choice) for choice in allowed)
        raise InputError(f"{what}: `{name}` must be one of {listing}, got {value!r}. Choose one of these.")


@cache
def _choices_of(cls: type) -> tuple[tuple[str, tuple[object, ...]], ...]:
    """Return name and allowed values of each field of a settings class that has a Literal type."""
    return tuple((name, values) for name, hint in get_type_hints(cls).items() if (values := _values_of(hint)))


def _values_of(hint: object) -> tuple[object, ...]:
    """Return the values of a Literal type, including None if it is optional. Other types give an empty tuple."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else ()
    values = [(None,) if part is type(None) else _values_of(part) for part in parts]
    return sum(values, ()) if all(values) else ()  # one part without a Literal allows any value
