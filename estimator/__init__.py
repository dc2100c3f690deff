"""Measures the spot in microscope frames and computes its distance.

run/       Reader and its three modes; reads a source to its end: `eyespot track`
sources/   Sources of frames: stacks, images, videos, cameras, ROS bags
detector/  From a frame to a spot: the paper's literal algorithm and sub-pixel mode
distance/  From a spot to a distance, by one of the models
pixels/    Tip and axis of the beam from all pixels of the spot
rig/       The node for ROS 1 and ROS 2
console/   A page for the operator: `eyespot console`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
