"""Fits to every pixel of a stack, whatever the wall shows."""
