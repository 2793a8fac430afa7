"""The constants that the source uses."""

from enum import Enum


class TerminalConfiguration(Enum):
    RSE = 10083
    NRSE = 10078
    DIFF = 10106
    PSEUDO_DIFF = 12529
    DEFAULT = -1


class AcquisitionType(Enum):
    FINITE = 10178
    CONTINUOUS = 10123
