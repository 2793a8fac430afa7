"""Methods that all fits share: least squares with named sources of uncertainty, triad models, curves over temperature.

    gls       generalised least squares with excess variances and a budget, the inverse model, robust fits
    triad     model of a triad from its fit: matrix, offset and g-sensitivity, with covariance and budget
    curve     curves over temperature, with their covariance
    carried   means of gravity in the level frame of the strapdown, for fits in motion
    priors    sizes of error sources that the readings of a session cannot determine

Input: readings (E, 3), designs (E, P), and covariances of the rows by source. Output: parameters with covariance and a budget by
source, which certificate, report and verdict use. Units are the units of the readings. Nothing here depends on a session. Open gls
first.
"""
