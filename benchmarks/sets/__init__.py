"""Labelled sets: from a spec with distributions to splits of stacks (docs/datasets.md)."""
