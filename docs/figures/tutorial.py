"""Pictures of the tutorial, on a simulated device: a session with its stills and turns, a calibration, a trial against optics."""

import contextlib
import io
import sys
import tempfile
from pathlib import Path

import numpy as np

import undrift
from undrift.cli.app import run
from undrift.report.figures import save_figure


def draw(folder: Path) -> None:
    """Draw them into a folder."""
    rng = np.random.default_rng(7)
    device = undrift.random_device(rng)
    session = undrift.simulate_session("ferraris", device, rng=rng)
    calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    with tempfile.TemporaryDirectory() as held:
        undrift.write_session(session, Path(held) / "session")
        picture = str(folder / "tutorial-session.svg")
        with contextlib.redirect_stdout(io.StringIO()):
            if run(["info", str(Path(held) / "session"), "--figure", picture]) != 0:
                raise SystemExit("undrift info failed")
    save_figure(calibration.plot(), folder / "tutorial-calibration.svg")
    trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    judged = undrift.validate_trial(trial.record, trial.reference, calibration=calibration, name="sit-to-stand")
    save_figure(judged.plot(), folder / "tutorial-trial.svg")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
