"""Benchmarks of speed and accuracy, each compared with alternatives.

`python -m benchmarks.bench NAME` runs one of them; `make bench` runs most of them.

__main__           The command line
cone_fit           Accuracy of the fit of the exact geometry to ellipses
estimator/         Accuracy and speed of the estimator
frame_pose         Accuracy of tip and axis from all pixels of single rendered frames
image_fit          Accuracy of the fit to all pixels of rendered stacks
lens_fit           Time and accuracy of the fit of a lens to pixels
load               Long measurements: `eyespot track` of many frames, and a `Reader` that keeps a
                   camera's pace
output             Tables on the terminal, processor times, memory, and lines of a file
photon_fit         Accuracy of a lens fitted through its own glass, with Mitsuba behind JAX
pixel_adverse      The mode pixels where beams, walls and cameras are not as it believes
pixel_branches     Whether the mode pixels takes the wrong one of two distances behind a lens
pixel_coverage     Whether the stated errors of the mode pixels hold, on many single frames
pixel_frames       Drawn stacks, and their frames read in the mode pixels and in the other modes
pixel_memory       Memory and time of the mode pixels over many frames
pixel_pose         Accuracy and stated errors of the mode pixels on rendered stacks
pixel_set          The mode pixels on the stacks of a set with adverse conditions
set_size           How the cost of a set grows, with its stacks and with its workers
viewing_speed      Time of lines of sight and of exact spots through a contact lens into an eye
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
