"""Study: which calibration protocol is enough for a task, found by simulation and judged by analysis of variance."""
