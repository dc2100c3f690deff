"""Labelled sets: from a spec with distributions to splits of stacks on disk.

docs/datasets.md says what is in the folder of a set. The same spec gives the same bytes.
"""
