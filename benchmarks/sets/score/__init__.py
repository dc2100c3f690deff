"""Compares measured spots with the labels of a set: `eyespot score`."""
