"""Labelled image stacks on disk."""
