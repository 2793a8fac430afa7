"""The README's picture: BROAD trial 35 against optics, raw, with the rest offset subtracted, and calibrated on the other recording.

`python docs/figures/readme_trial.py docs/readme-trial.svg` draws it; UNDRIFT_DATA names the folder with broad/. Gyroscopes alone,
tilt from the rest before, heading from the optics at the start. The calibration comes from the device's other recording, never from
this one.
Data: BROAD, Laidig, Caruso, Cereatti and Seel, Data 2021, CC BY 4.0.
"""

import os
import sys
from pathlib import Path

import numpy as np
from benchmarks.broad_files import read_broad

from undrift import Calibration, validate_trial
from undrift.calibration.codes import device_adc
from undrift.calibration.reference import leave_one_out
from undrift.report.figures import DEVICE, ERROR, new_figure, save_figure
from undrift.units import STANDARD_GRAVITY
from undrift.validation.trial import TrialSettings

SHOWN, OTHER = "35", "32"  # of device D
SHAPES = (  # name, colour, dash, and where its name stands, deg
    ("raw", "#5c5c5c", (0, (1, 1.2)), 16.8),
    ("rest offset subtracted", ERROR, (0, (5, 2)), 4.5),
    ("calibrated", DEVICE, "solid", 1.9),
)


def errors() -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, float]]:
    """Return the time from the start of the motion, s, and the total error and the end error of each way, deg."""
    folder = Path(os.environ.get("UNDRIFT_DATA", "../shared/data")) / "broad"
    pairs = [read_broad(next(folder.glob(f"{number}_*.hdf5"))) for number in (SHOWN, OTHER)]
    records, references = zip(*pairs, strict=True)
    adc = device_adc(records)
    held = leave_one_out(records, references, adc=adc)[0]
    calibration = Calibration(
        device="D", reference_temp_c=np.nan, gravity_m_s2=STANDARD_GRAVITY, gyro=held.model, adc=adc
    )
    trials = {
        "raw": validate_trial(records[0], references[0]),
        "rest offset subtracted": validate_trial(records[0], references[0], settings=TrialSettings(offset="rest")),
        "calibrated": validate_trial(records[0], references[0], calibration=calibration),
    }
    time = trials["raw"].time
    moving = np.flatnonzero(trials["raw"].moving)
    shown = slice(moving[0], moving[-1])
    courses = {name: np.degrees(t.error.total[shown]) for name, t in trials.items()}
    return time[shown] - time[moving[0]], courses, {name: t.figures.end_total_deg for name, t in trials.items()}


def draw(path: Path) -> dict[str, float]:
    """Draw the picture and return the end error of each way, deg."""
    time, found, ends = errors()
    figure, (axes,) = new_figure("angle to optics (deg)", x="time from the start of the motion (s)", height=2.7)
    for name, colour, dash, height in SHAPES:
        held = np.isfinite(found[name])
        t, y = time[held], found[name][held]
        kept = np.linspace(0, len(t) - 1, 420).astype(int)
        axes.plot(t[kept], y[kept], color=colour, linestyle=dash, linewidth=1.6)
        axes.text(t[-1], height, f"{name}: {ends[name]:.1f} deg", color=colour, ha="right")
    axes.set(xlim=(0, time[-1]), ylim=(0, 18))
    axes.set_title("Gyroscopes alone, 85 s of motion (BROAD, trial 35)", loc="left", fontsize=9)
    save_figure(figure, path)
    return ends


if __name__ == "__main__":
    for label, end in draw(Path(sys.argv[1])).items():
        print(f"{label}: {end:.2f} deg")
