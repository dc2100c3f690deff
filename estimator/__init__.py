"""Measures the spot in microscope frames and turns it into a distance.

detector/  From a frame to a spot: the paper's literal algorithm and sub-pixel mode
distance/  From a spot to a distance, by one of the models
files/     The files that people exchange: schemas, readers and writers
image/     What a frame is, and what is measured in it
rig/       The ROS 1 node
run/       Reads a source to its end: `eyespot track`
sources/   Where frames come from: stacks, images, videos, cameras, ROS bags
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
