"""What is known of a part's matrices before a device of it was calibrated: sizes of their deviations, and what they share.

::

    t = T (M - I, A - I, p)      t_d ~ N(mean, size^2 of each kind)      M and A of a device d, p its accelerometers' offset

Kinds, three elements each: scale factors and symmetric cross-axis terms of both triads, the rotation from one triad to the other,
that of both in the case, and the offset of the accelerometers. Sizes begin as those of data sheets and publications, known as if
from some elements, and follow what calibrated devices of the part deviate by (expectation maximisation, each device with its own
covariance).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.codec import stored
from undrift.errors import InputError
from undrift.model import OFFSET_NAMES, Calibration
from undrift.units import Quantity, is_physical, si_factor

_ROUNDS = 200  # of the expectation maximisation


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class KindSize:
    """Standard deviation of a kind of element over devices, known as if from some elements, about a mean of each of its three."""

    size: float
    as_from: float
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)


@stored(kind="undrift.prior", format=1)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ElementPrior:
    """What a device of a part deviates by: matrices against the identity, readings in physical units."""

    # Twice what is published of 16 units of one part, scale factors of 0.12 to 0.20 and 0.07 to 0.14 %, for elements of both triads
    # (symmetric cross-axis terms 0.05 to 2.4 mrad, between the triads 0.3 to 1.2); cross-axis terms known as if from thirty
    # elements, scale factors from six, since a raw device's may be off by 3 %, as are offsets by data sheets [assumed]
    source: str = "publications and data sheets"
    devices: int = 0  # It was learnt from
    gyro_scale: KindSize = KindSize(size=0.004, as_from=6.0)
    gyro_cross: KindSize = KindSize(size=0.0028, as_from=30.0)  # (m_ij + m_ji) / 2
    accel_scale: KindSize = KindSize(size=0.004, as_from=6.0)
    accel_cross: KindSize = KindSize(size=0.0028, as_from=30.0)
    between: KindSize = KindSize(
        size=0.004, as_from=30.0
    )  # Rotation of the gyroscopes less that of the accelerometers, rad
    case: KindSize = KindSize(size=0.002, as_from=30.0)  # Mean of both, rad
    accel_offset: KindSize = KindSize(size=0.3, as_from=6.0)  # m/s2

    @property
    def kinds(self) -> tuple[KindSize, ...]:
        """Kinds in the order of the elements."""
        return tuple(getattr(self, name) for name in KINDS)

    @property
    def mean(self) -> FloatArray:
        """What devices of the part share, (21,)."""
        return np.array([one.mean for one in self.kinds]).reshape(-1)

    def sizes(self, square: FloatArray) -> FloatArray:
        """Return sizes (7,), as squares (..., 21) of elements about the mean have them beside what was known."""
        total = square.reshape(-1, 7, 3).sum(axis=(0, 2))
        size, as_from = np.array([(one.size, one.as_from) for one in self.kinds]).T
        wide: FloatArray = np.sqrt((as_from * size**2 + total) / (as_from + square.size / 7.0))
        return wide


KINDS = tuple(one.name for one in fields(ElementPrior))[2:]


def _elements() -> FloatArray:
    """Return T (21, 21), from both matrices, row by row, and the offset to the kinds."""
    scale, cross, turn = np.zeros((3, 3, 9))
    for k, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
        scale[k, 4 * k] = 1.0
        cross[k, [3 * i + j, 3 * j + i]] = 0.5
        turn[k, [3 * i + j, 3 * j + i]] = 0.5, -0.5
    none = np.zeros((3, 9))
    rows = ((scale, none), (cross, none), (none, scale), (none, cross), (turn, -turn), (0.5 * turn, 0.5 * turn))
    whole = np.eye(21)
    whole[:18, :18] = np.block([list(row) for row in rows])
    return whole


ELEMENTS, PUBLISHED = _elements(), ElementPrior()


def by_kinds(covariance: FloatArray) -> FloatArray:
    """Return the variances by kinds (21,), from the covariance of M, A and p, its first 21 rows."""
    return np.diag(ELEMENTS @ covariance[:21, :21] @ ELEMENTS.T)


def learn_prior(calibrations: Sequence[Calibration], source: str, prior: ElementPrior = PUBLISHED) -> ElementPrior:
    """Return the prior of a part after calibrated devices of it, one calibration each, of both triads in physical units.

    Raises InputError for a calibration that cannot be counted, with the reason.
    """
    values, spreads = zip(*(deviation_of(one) for one in calibrations), strict=True) if calibrations else ((), ())
    mean, square = prior.mean, np.zeros((0, 21))
    for _ in range(_ROUNDS):
        variance = np.repeat(prior.sizes(square), 3) ** 2
        gains = [np.linalg.solve(spread + np.diag(variance), np.diag(variance)).T for spread in spreads]
        posts = [mean + gain @ (value - mean) for gain, value in zip(gains, values, strict=True)]
        loose = [variance - gain.diagonal() * variance for gain in gains]
        mean = (prior.mean + np.sum(posts, axis=0)) / (
            1.0 + len(posts)
        )  # the mean is as near to the old one as a device
        about = variance / (1.0 + len(posts))
        square = np.array([(post - mean) ** 2 + more + about for post, more in zip(posts, loose, strict=True)])
    sizes = prior.sizes(square)
    learnt = {
        name: KindSize(size=float(size), as_from=one.as_from + 3.0 * len(values), mean=tuple(shared.tolist()))
        for name, size, one, shared in zip(KINDS, sizes, prior.kinds, mean.reshape(7, 3), strict=True)
    }
    return ElementPrior(source=source, devices=len(values), **learnt)


def deviation_of(calibration: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return what a device deviates by (21,), and its covariance; InputError where it cannot be counted, with the reason."""
    value, covariance = np.zeros(21), np.zeros((21, 21))
    for first, triad in ((0, calibration.gyro), (9, calibration.accel)):
        name = "accelerometers" if first else "gyroscopes"
        if triad is None or not is_physical(triad.unit_in) or not triad.covariance[:9, :9].any():
            raise InputError(f"wanted both triads in physical units with an uncertainty, got none of the {name}")
        if triad.method == "motion":
            raise InputError("wanted a calibration that leans on no prior, got one from motion alone")
        quantity: Quantity = "accel" if first else "rate"
        unit = si_factor(triad.unit_in, quantity)
        factor = unit / si_factor(triad.unit_out, quantity)
        places = [*range(9), *(triad.parameters.index(one) for one in OFFSET_NAMES)][: 12 if first else 9]
        scale = np.repeat((1.0 / factor, unit), (9, 3))[: len(places)]
        where = [*range(first, first + 9), *range(18, 21)][: len(places)]
        value[where] = np.concatenate((triad.matrix.ravel() / factor - np.eye(3).ravel(), triad.offset * unit))[
            : len(places)
        ]
        covariance[np.ix_(where, where)] = scale[:, None] * triad.covariance[np.ix_(places, places)] * scale
    return ELEMENTS @ value, ELEMENTS @ covariance @ ELEMENTS.T
