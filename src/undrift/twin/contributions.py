"""Contributions: what each part of the twin, and of the comparison itself, adds to the difference from the real device.

Every part is simulated alone against a twin without it, over the same windows of the same held-out motion. What the poses
add at rest is measured: the real gyroscope against the poses over windows before the motion. Parts add as squares; what is
left of the difference found is unexplained: poses that err more in motion than at rest, markers and board that give, and
effects of the device that the model lacks, which these recordings cannot tell apart.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.segments.still import runs
from undrift.sim.device.model import DeviceModel
from undrift.twin.device import drawn_gyro
from undrift.twin.fit import Prepared, fit_prepared
from undrift.twin.heldout import Stage, WindowErrors, hold_out, plain, run_errors, window_errors

DRAWS = 5
_MARGIN_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """One contribution.

    Parameters
    ----------
    name : str
        What it is.
    pitch : float
        Median over windows of the largest difference of pitch, rad.
    tilt : float
        Median over windows of the largest angle between the verticals, rad.
    """

    name: str
    pitch: float
    tilt: float


def contributions(
    prepared: Prepared, number: int, *, rng: np.random.Generator, length_s: float = 5.0
) -> tuple[Part, ...]:
    """Return what limits the twin on one held-out recording.

    Parameters
    ----------
    prepared : Prepared
        Two recordings of a device or more.
    number : int
        Which one is held out.
    rng : Generator
        Noise and draws.
    length_s : float
        Length of the windows, s.

    Returns
    -------
    tuple of Part
        White noise, ADC, uncertainty of the fit, poses at rest, what is unexplained, the whole, and the whole with a twin
        fitted to the held-out recording itself: no better twin is to be had from these poses.

    Raises
    ------
    InputError
        One recording alone.
    """
    stage = hold_out(prepared, number)
    bare = plain(stage.device)
    ideal = stage.simulated(bare, rng)

    def alone(device: DeviceModel) -> WindowErrors:
        return window_errors(stage, stage.simulated(device, rng), ideal, length_s)

    white = replace(bare, gyro=replace(bare.gyro, white_noise=stage.device.gyro.white_noise))
    codes = replace(bare, gyro=replace(bare.gyro, adc=stage.device.gyro.adc))
    fits = [alone(drawn_gyro(bare, stage.twin, rng)) for _ in range(DRAWS)]
    whole = _part(
        "found", window_errors(stage, stage.corrected(stage.match.gyro, stage.offset), stage.simulated(stage.device, rng), length_s)
    )  # fmt: skip
    parts = [
        _part("white noise", alone(white)),
        _part("ADC steps", alone(codes)),
        Part(
            name="uncertainty of matrix and offset",
            pitch=float(np.mean([_part("", e).pitch for e in fits])),
            tilt=float(np.mean([_part("", e).tilt for e in fits])),
        ),
        _part("device and poses at rest", _at_rest(stage, length_s)),
    ]
    known = parts[1:] if np.isfinite(parts[3].pitch) else parts[:3]  # the rest holds white noise already
    left = Part(
        name="unexplained",
        pitch=_rest_of(whole.pitch, [p.pitch for p in known]),
        tilt=_rest_of(whole.tilt, [p.tilt for p in known]),
    )
    itself = hold_out(prepared, number, twin=fit_prepared(prepared, chosen=[number], brief=True))
    same = itself.corrected(itself.match.gyro, itself.offset)
    own = _part("found with a twin of this recording", window_errors(
        itself, same, itself.simulated(itself.device, rng), length_s
    ))  # fmt: skip
    return (*parts, left, whole, own)


def _at_rest(stage: Stage, length_s: float) -> WindowErrors:
    match, motion = stage.match, stage.motion
    still = (motion.time < match.span.start_s - _MARGIN_S) & (np.asarray(motion.valid) > 0.0)
    real = stage.corrected(match.gyro, match.rest_offset)
    seen = np.nan_to_num(motion.mean_rate_b)
    rows = [run_errors(motion, real, seen, slice(int(a), int(b)), length_s) for a, b in runs(still)]
    table = np.concatenate([r for r in rows if len(r)] or [np.empty((0, 5))])
    return WindowErrors(pitch=table[:, 0], tilt=table[:, 1], end=table[:, 2:])


def _part(name: str, errors: WindowErrors) -> Part:
    seen = errors.pitch[np.isfinite(errors.pitch)]
    pitch = float(np.median(seen)) if len(seen) else float("nan")
    return Part(name=name, pitch=pitch, tilt=float(np.median(errors.tilt)) if len(errors.tilt) else float("nan"))


def _rest_of(whole: float, parts: list[float]) -> float:
    square = whole**2 - float(np.sum(np.square(np.asarray(parts, dtype=np.float64))))
    return float(np.sqrt(max(square, 0.0)))
