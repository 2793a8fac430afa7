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
