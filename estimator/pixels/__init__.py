"""Tip and axis of the beam from all pixels of the spot, on a wall that is learnt meanwhile.

Each file imports only those above it:

cells        The light of a frame on a lattice of square cells, on a wall that moves in the image
beam         The light of a calibrated beam on a window's cells, blurred, with derivatives
frame_model  The model of one frame: its states, its light on a window's cells, and the priors
solver       Poses of some frames by Gauss-Newton, with the wall's texture eliminated
frame_fit    Fits the newest frame: other light has little weight, and the wall may have moved
picture      The pixels of a frame: their light, and which of them show the wall
first_frame  Explains a frame by itself, or together with earlier ones that show a part of its wall
verdict      Whether a pose explains its frame, and what its stated error contains
tracker      Follows the pose from frame to frame, for a calibration and a microscope file
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
