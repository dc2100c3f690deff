"""Benchmarks of speed and accuracy: functions that return a table; see `__main__`.

What `eyespot score` and the studies measure is not measured here again.
"""
