"""Fits, one procedure a file; each returns a ``TriadFit``: model, covariance, residuals, rank, condition, range, verdict.

    six_face          six faces up and down                    parts: tilt (how level the faces lay)
    rate_table        steady turns about three axes            parts: dwells, linearity; rate_rests joins the rests (wandering)
    known_rotation    six faces and three turns by hand
    multi_position    free poses and moves, nothing else       parts: multi_position_*, norm, still_variance, excess
    reference         motion beside an orientation reference   parts: reference_*

Shared: ``result`` (the value), ``linear`` (weighted least squares of known inputs), ``noise`` (of means).
"""
