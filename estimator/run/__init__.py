"""Reads a source to its end: `eyespot track`.

command       The command `eyespot track`: opens what it is given, shows progress, writes and
              reports
offline       A recorded (or live) source, read from its first frame to its last: the spots' records
options       What a person chooses for a measurement, for `eyespot track` and for the rig's node
              alike
overlay       What was measured, drawn over the frames: a video or a folder of PNGs to look through
progress_bar  Progress of a long command: a bar on a terminal, else a plain line now and then
reader        From a frame to a reading: the spot, its distance, the age of the robot's pose
summary       What a run of `eyespot track` came to: counts by reason, for a person and for a
              program
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
