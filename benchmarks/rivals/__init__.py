"""Rivals: other ways to measure a spot, each an entry whose spots `eyespot score` ranks."""
