"""Comparison of calibration and orientation methods on public recordings: `python -m benchmarks.public`.

orientation   BROAD: calibrations by filters
bench         poses, six faces, a rate table, a warm-up, Allan deviation
rivals        other programs, in an environment of their own
table         a row and its interval
"""
