"""The command `eyespot fit`."""
