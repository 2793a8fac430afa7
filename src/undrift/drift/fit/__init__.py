"""Fits of drift, one a file.

spline      curves over temperature with covariance: not-a-knot and smoothing    parts: weigh, wiener (the algebra)
static      offset over temperature from blocks of rest                          parts: offsets, cells, curve, hysteresis, warm_up
combine     how far several sessions of one device lie apart
scale       the gyroscopes' matrix over temperature from rate steps              part: steps
dynamic     what is left over measured rate and temperature                      part: tensor
choose      which of scale and dynamic tables foretell best
asymmetry   scale factors of the two ways round
accel       accelerometers over temperature from poses                           part: warm_poses
"""
