"""``undrift twin``: the device model fitted to a real device, and its errors on recordings held out."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.options import Files, OptionalOutput, verb
from undrift.base.summary import Result, Section, Summary, figure_of, number, rows_section
from undrift.commands import Progress, part_of, silent
from undrift.commands.files import Opening, Optics, check_output
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.twin.fit import Twin
    from undrift.twin.held_out import HeldOutTrial

HELD_OUT = (0.34, 1.0)  # share of the time, for three recordings of two minutes


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Twinned(Result):
    """A device model fitted to a real device, with its errors on recordings held out."""

    fitted: "Twin"
    held_out: "tuple[HeldOutTrial, ...]"
    output: Path | None

    def summary(self) -> Summary:
        """Return the parameters and the errors of the prediction."""
        import numpy as np

        fitted, held_out, count = self.fitted, self.held_out, len(self.fitted.prepared.matches)
        known = sum(p.identifiable for p in fitted.parameters)
        answer = f"The recordings identify {known} of {len(fitted.parameters)} parameters of the device"
        if held_out:
            pitch = _spread(np.concatenate([trial.pitch for trial in held_out]) / RADIAN_PER_DEGREE)
            answer += (
                f". On recordings held out, its pitch differs from the real device's by at most {pitch['p95']:.2f} deg in 95 % of "
                f"windows of {held_out[0].window_s:g} s (median {pitch['median']:.2f} deg)"
            )
        note = "With one recording, none can be held out. Add a second recording to measure the accuracy of the twin."
        return Summary(
            title=f"Twin of a real device, from {count} recording{'s' if count > 1 else ''}",
            answer=answer + ".",
            data=_data(fitted, held_out),
            pictures=(figure_of("figures:draw_held_out", held_out),) if held_out else (),
            sections=_sections(fitted, held_out),
            findings=fitted.gyro.triad.verdict.findings,
            notes=() if held_out else (note,),
            written=(self.output,),
            next=("simulate", "sit_to_stand", "--device", self.output, "-o", "trial.parquet") if self.output else (),
        )


@verb
def twin(
    *records: Files,
    optics: Optics = Optics(),
    gravity_m_s2: float = STANDARD_GRAVITY,
    seed: int = 0,
    output: OptionalOutput = None,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Twinned:
    """Fit the device model to a real device from recordings with an optical reference.

    With two recordings or more, each is held out in turn: a device fitted to the others is simulated on its motion and compared
    with the real readings.

    Parameters
    ----------
    records : Path
        Raw recordings of one device in one mounting. Without a rest, a recording has the device's offset in motion.
    gravity_m_s2 : float
        Local gravity, m/s2: the accelerometer's scale is proportional to it.
    seed : int
        Seed of the noise of simulated devices.
    output : Path or None
        device.json to write.
    """
    import numpy as np

    from undrift.sim.device.model import write_device
    from undrift.twin.fit import fit_prepared, prepare_twin
    from undrift.twin.held_out import compare_held_out, device_of

    check_output(output, endings=("",), reads=(*records, *optics.reference))
    pairs = optics.pairs(records, opening, command="twin")
    names = [record.name.split(".")[0] for record in records]
    progress("aligning", 0.01)
    prepared = prepare_twin([p[0] for p in pairs], [p[1] for p in pairs], gravity_m_s2=gravity_m_s2, names=names)
    progress("fitting", 0.13)
    fitted = fit_prepared(prepared)
    held_out: tuple[HeldOutTrial, ...] = ()
    if len(records) > 1:
        held_out = compare_held_out(prepared, rng=np.random.default_rng(seed), progress=part_of(progress, *HELD_OUT))
    if output is not None:
        first = prepared.matches[0].record
        write_device(device_of(fitted, sample_rate_hz=first.sample_rate_hz, serial=first.device), output)
    return Twinned(fitted=fitted, held_out=held_out, output=output)


def _spread(values: "FloatArray") -> dict[str, float]:
    """Return median, 95th percentile and largest value, without gaps."""
    import numpy as np

    known = values[np.isfinite(values)] if np.isfinite(values).any() else np.array([np.nan])
    return dict(zip(("median", "p95", "max"), np.quantile(known, (0.5, 0.95, 1.0)).tolist(), strict=True))


def _data(fitted: "Twin", held_out: "tuple[HeldOutTrial, ...]") -> dict[str, object]:
    deg = 1.0 / RADIAN_PER_DEGREE
    keys = ("name", "value", "standard_error", "unit", "identifiable", "reason")
    return {
        "parameters": [{key: getattr(p, key) for key in keys} for p in fitted.parameters],
        "heldout": [
            {
                "recording": trial.recording,
                "window_s": trial.window_s,
                "windows": len(trial.pitch),
                "max_abs_pitch_difference_deg": _spread(trial.pitch * deg),
                "end_difference_deg": [_spread(axis * deg) for axis in trial.end.T],
            }
            for trial in held_out
        ],
    }


def _sections(fitted: "Twin", held_out: "tuple[HeldOutTrial, ...]") -> tuple[Section, ...]:
    deg = 1.0 / RADIAN_PER_DEGREE
    parameters = [
        {
            "name": p.name,
            "value": number(p.value, ".6g"),
            "standard error": number(p.standard_error, ".2g"),
            "unit": p.unit,
        }
        for p in fitted.parameters
        if p.identifiable
    ]
    unidentified = tuple(f"{p.name} is not identified: {p.reason}." for p in fitted.parameters if not p.identifiable)
    windows = [
        {
            "recording": trial.recording,
            "window s": f"{trial.window_s:g}",
            "windows": str(len(trial.pitch)),
            **{name: f"{value:.2f}" for name, value in _spread(trial.pitch * deg).items()},
        }
        for trial in held_out
    ]
    held_title = "held out: largest pitch difference between simulated and real device in a window, deg"
    return (
        rows_section("parameters of the device", parameters, text=unidentified, words=True),
        *((rows_section(held_title, windows),) if windows else ()),
    )
