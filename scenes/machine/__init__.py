"""Checks for Mitsuba and the system libraries that it needs."""
