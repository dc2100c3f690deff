"""Fits to the ellipses of spots."""
