"""A page in the browser for the operator of a rig: `eyespot console`."""
