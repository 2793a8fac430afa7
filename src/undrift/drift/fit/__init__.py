"""Fits of drift, one a file.

spline      curves over temperature with their covariance: not-a-knot and smoothing   part: wiener (the algebra)
static      offset over temperature from blocks of rest                               parts: offsets, cells, curve, hysteresis, warm_up
combine     several sessions of one device in one table
"""
