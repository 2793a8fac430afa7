"""How a device changed between its calibrations, with the standard uncertainty of each change.

For an earlier model (M1, o1) and a later one (M2, o2), with K1 = M1^-1, the gain and the offset changed by

    D = M2 K1 - 1                 D_ii scale factor, D_ij cross-axis, both relative
    d = M1 (o2 - o1)              offset in units of the corrected value
    Cov vec D = (1 x K1') (C1 + C2) (1 x K1')'      Cov d = M1 (C1 + C2) M1'     + (s dT)^2 on each

C1 and C2 are the covariances that the files keep, to first order in D. Both calibrations count as independent: what one rig has in
common in both cancels in truth, so the uncertainty is on the large side. s are the sensitivities to temperature of consumer parts
(record.TemperatureSensitivity) and dT is the difference of the reference temperatures.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

import numpy as np

from undrift.arrays import FloatArray
from undrift.model import AXES, Calibration, TriadModel
from undrift.record import TemperatureSensitivity
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

MOVED = 3.0  # standard uncertainties, from which a change is reported
UNKNOWN_K = 5.0  # difference of temperatures that nobody recorded, K
FARTHEST_K = 10.0  # reference temperatures that differ by more are not compared
UNITS = {"gyro": ("deg/s", RADIAN_PER_DEGREE), "accel": ("mg", STANDARD_GRAVITY / 1e3)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Dated:
    """A calibration of the registry."""

    entry: int
    made_at: datetime
    model: Calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One parameter that changed."""

    sensor: str  # gyro or accel
    parameter: str  # scale x, cross-axis xy, offset x
    change: float
    uncertainty: float  # standard uncertainty of the change
    unit: str  # %, deg/s or mg

    @property
    def name(self) -> str:
        """What changed: scale of gyro y."""
        what, axes = self.parameter.split()
        return f"{what} of {self.sensor} {axes}"

    @property
    def sigmas(self) -> float:
        """The change in standard uncertainties."""
        return abs(self.change) / self.uncertainty


@dataclass(frozen=True, slots=True, kw_only=True)
class TrendStep:
    """From one calibration to the next."""

    since: Dated
    until: Dated
    changes: tuple[Change, ...]
    not_compared: tuple[str, ...]  # what, and why

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a person should know of it, the largest change first."""
        day = f"{self.since.made_at:%Y-%m-%d}"
        largest = sorted(self.changes, key=lambda one: -one.sigmas)
        moved = [one for one in largest if one.sigmas >= MOVED]
        if moved:
            return tuple(
                f"{one.name} moved by {one.sigmas:.1f} sigma since {day}: {one.change:+.2g} {one.unit}" for one in moved
            )
        if not largest:
            return (f"nothing to compare since {day}",)
        top = largest[0]
        return (f"nothing moved by {MOVED:g} sigma since {day}; largest: {top.name}, {top.sigmas:.1f} sigma",)


def trend(calibrations: Sequence[Dated]) -> list[TrendStep]:
    """Compare each calibration with the one before."""
    return [compare(before, after) for before, after in pairwise(calibrations)]


def headline(steps: Sequence[TrendStep], from_first: Sequence[TrendStep]) -> str:
    """Return what to know first: what moved since the calibration before, else since the first, which shows a slow drift."""
    last, total = steps[-1], from_first[-1]
    moved = (step.sentences[0] for step in (last, total) if any(one.sigmas >= MOVED for one in step.changes))
    return next(moved, last.sentences[0])


def course(calibrations: Sequence[Dated]) -> list[TrendStep]:
    """Compare each calibration with the first: what a picture shows."""
    return [compare(calibrations[0], later) for later in calibrations[1:]]


def compare(before: Dated, after: Dated) -> TrendStep:
    """Return what changed between two calibrations, and what cannot be compared."""
    a, b = before.model, after.model
    same = {digest for _, digest in a.provenance.inputs} & {digest for _, digest in b.provenance.inputs}
    apart_k = abs(b.reference_temp_c - a.reference_temp_c)
    changes: list[Change] = []
    left: list[str] = []
    if np.isnan(apart_k):
        left.append(f"temperature is not recorded in both: a difference of {UNKNOWN_K:g} K is assumed")
        apart_k = UNKNOWN_K
    for name in ("gyro", "accel"):
        old: TriadModel | None = getattr(a, name)
        new: TriadModel | None = getattr(b, name)
        why = _not_comparable(old, new, apart_k, len(same))
        if why or old is None or new is None:
            left.append(f"{name}: {why}")
            continue
        found = [*_changes(name, old, new, apart_k)]
        changes += [one for one in found if one.uncertainty > 0.0]
        held = [one.parameter for one in found if not one.uncertainty > 0.0]
        left += [f"{name}: {', '.join(held)}: no uncertainty is stated"] if held else []
        if old.g_sensitivity is not None and new.g_sensitivity is not None:
            left.append(f"{name}: g-sensitivity is not part of the trend")
    return TrendStep(since=before, until=after, changes=tuple(changes), not_compared=tuple(left))


def _not_comparable(old: TriadModel | None, new: TriadModel | None, apart_k: float, same: int) -> str:
    if old is None or new is None:
        return "not calibrated in both"
    if (old.unit_in, old.unit_out) != (new.unit_in, new.unit_out):
        return f"units differ, {old.unit_out} per {old.unit_in} and {new.unit_out} per {new.unit_in}"
    if same:
        return f"both come from the same recordings ({same} files)"
    if apart_k > FARTHEST_K:
        return f"reference temperatures differ by {apart_k:.1f} K, more than {FARTHEST_K:g} K"
    if not (np.isfinite(old.covariance).all() and np.isfinite(new.covariance).all()):
        return "no uncertainty is stated"
    return ""


def _changes(name: str, old: TriadModel, new: TriadModel, apart_k: float) -> Iterator[Change]:
    prior, (unit, factor) = TemperatureSensitivity(), UNITS[name]
    gyro = name == "gyro"
    of_scale = 0.01 * apart_k * (prior.gyro_scale_percent_per_k if gyro else prior.accel_scale_percent_per_k)
    of_offset = apart_k * factor * (prior.gyro_offset_dps_per_k if gyro else prior.accel_offset_mg_per_k)
    k = old.forward_matrix
    gain = new.matrix @ k - np.eye(3)
    spread = np.kron(np.eye(3), k.T)  # of a matrix row by row
    both = _block(old, 0, 9) + _block(new, 0, 9)
    known = both.diagonal() > 0.0  # a parameter that was held has no uncertainty, and its change neither
    variance = np.where(known, (spread @ both @ spread.T).diagonal() + of_scale**2 * np.eye(3).ravel(), 0.0)
    for n, (row, column) in enumerate((row, column) for row in range(3) for column in range(3)):
        what = f"scale {AXES[row]}" if row == column else f"cross-axis {AXES[row]}{AXES[column]}"
        yield Change(
            sensor=name, parameter=what, change=100.0 * float(gain[row, column]), uncertainty=100.0 * float(np.sqrt(variance[n])),
            unit="%",
        )  # fmt: skip
    moved = old.matrix @ (new.offset - old.offset) / factor
    own = _block(old, 9, 12) + _block(new, 9, 12)
    wide = (old.matrix @ own @ old.matrix.T).diagonal() + of_offset**2
    wide = np.where(own.diagonal() > 0.0, wide, 0.0)
    for n, axis in enumerate(AXES):
        yield Change(
            sensor=name,
            parameter=f"offset {axis}",
            change=float(moved[n]),
            uncertainty=float(np.sqrt(wide[n])) / factor,
            unit=unit,
        )


def _block(triad: TriadModel, start: int, stop: int) -> FloatArray:
    """Return a block of the covariance; zeros where the fit has no such parameters."""
    block = np.zeros((stop - start, stop - start))
    end = min(stop, len(triad.parameters))
    if end > start:
        block[: end - start, : end - start] = triad.covariance[start:end, start:end]
    return block
