"""Reads a source to its end: `eyespot track`."""
