"""Tip and axis of the beam from all pixels of the spot, on a wall that is learnt meanwhile.

beam     The light of a calibrated beam on the cells of a window, with its derivatives
cells    The light of a frame on a lattice of square cells
mix      The mixture of a camera's channels in which the wall is most even
ranger   Distances and poses, for a calibration and a microscope file
solver   Poses of some frames by Gauss-Newton, with the wall's texture eliminated
starts   Poses from which the fit of a first frame starts
texture  The wall's texture as a Gaussian process
tracker  Follows the pose from frame to frame
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
