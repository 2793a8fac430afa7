"""One device of a study: failed fits are counted, other errors are not hidden."""

import numpy as np
import pytest

from undrift.errors import InputError, NotObservable
from undrift.study import run as run_module
from undrift.study.plan import Study, StudyTask
from undrift.study.run import run_chosen
from undrift.study.sessions import SESSIONS

STUDY = Study(tasks=(StudyTask(name="sit_to_stand"),), sessions=(SESSIONS["hand"],))
CHOSEN = (("sit_to_stand", "hand"),)


def failing(error):
    def calibrate(*given, **stated):
        raise error

    return calibrate


def test_failed_fit_is_a_run_without_an_error(monkeypatch):
    monkeypatch.setattr(run_module, "calibrate_before_soaks", failing(NotObservable("no turn")))
    assert [np.isnan(run.rms_deg) for run in run_chosen(STUDY, CHOSEN, 0)] == [True]


def test_wrong_call_is_not_hidden(monkeypatch):
    monkeypatch.setattr(run_module, "calibrate_before_soaks", failing(InputError("no such mode")))
    with pytest.raises(InputError, match="no such mode"):
        run_chosen(STUDY, CHOSEN, 0)
