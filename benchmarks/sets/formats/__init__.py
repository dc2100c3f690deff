"""Writes sets in other formats: `eyespot export`."""
