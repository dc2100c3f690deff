"""Everything derived from a scene: wall, microscope, beam, motion, light, labels."""
