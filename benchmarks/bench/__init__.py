"""Benchmarks: functions that measure what no study and no score measures; see `__main__`."""
