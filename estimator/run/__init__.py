"""Reads a source to its end: `eyespot track`.

budget_command   The command `eyespot budget`: what the distances of a source are worth, and why
camera_command   The command `eyespot camera`: measures a camera's noise
command          The command `eyespot track`: opens a source, tracks it, writes the results and
                 reports
exit_codes       How a command ends: its message on an error, and its exit code
internal_errors  Bugs that are met in single frames: logged and counted, so that a long run reaches
                 its end
interrupt        Ctrl-C ends a command within two seconds, unless it is writing what it has
offline          Reads a source from its first frame to its last: the spots, and how many of each
                 kind
options          The options of a measurement, defined once for the commands and the rig's node
overlay          Draws the measured spots over the frames: a video, or a folder of PNGs
progress_bar     Progress of a long command: a bar on a terminal, else a plain line now and then
reader           From a frame to a reading: the spot, its distance, the age of the robot's pose
summary          Summary of a run of `eyespot track`: counts by reason, as a table or as JSON
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
