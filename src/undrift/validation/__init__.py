"""Validation: what a calibration is worth in degrees, on real motion, against an orientation reference.

``validate_trial`` judges one recording, ``validate_trials`` several, ``validate_leave_one_out`` a fit on recordings that it has
not seen. Below them: ``compare_orientations`` (error definitions), ``align_rates`` (mounting), ``bland_altman`` and
``intraclass_correlation`` (agreement over trials).
"""

from undrift.validation.agreement import BlandAltman, IntraclassCorrelation, bland_altman, intraclass_correlation
from undrift.validation.align import Alignment, align_rates
from undrift.validation.errors import OrientationError, compare_orientations
from undrift.validation.figures import Figures
from undrift.validation.trial import Mounting, Trial, TrialSettings, validate_trial
from undrift.validation.trials import Agreement, Validation, validate_leave_one_out, validate_trials

__all__ = [
    "validate_trial",
    "Trial",
    "Mounting",
    "TrialSettings",
    "Figures",
    "validate_trials",
    "validate_leave_one_out",
    "Validation",
    "Agreement",
    "compare_orientations",
    "OrientationError",
    "align_rates",
    "Alignment",
    "bland_altman",
    "BlandAltman",
    "intraclass_correlation",
    "IntraclassCorrelation",
]
