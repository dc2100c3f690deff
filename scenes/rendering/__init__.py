"""Rendering with Mitsuba: from a scene to linear frames."""
