"""Measures the spot in microscope frames and computes its distance.

console/   A page for the operator: `eyespot console`
detector/  From a frame to a spot: the paper's literal algorithm and sub-pixel mode
distance/  From a spot to a distance, by one of the models
files/     The files that people exchange: formats, readers and writers
image/     Frames, and the spot that is measured in them
pixels/    Tip and axis of the beam from all pixels of the spot
rig/       The node for ROS 1 and ROS 2
run/       Reads a source to its end: `eyespot track`
viewer/    Recordings for the viewer rerun
sources/   Sources of frames: stacks, images, videos, cameras, ROS bags
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
