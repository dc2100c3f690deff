"""Tip and axis of the beam from all pixels of the spot, on a wall that is learnt meanwhile.

ambient       What an error of the ambient light's shape would do to a pose
beam          The light of a calibrated beam on the cells of a window, with its derivatives
belief        One explanation of the frames so far, and which explanations stay possible
bend          What the bend of the likely poses does to a pose's stated errors
blur          A blur of the image, on the cells of a lattice
cells         The light of a frame on a lattice of square cells
drift         What a drift of the microscope would do to a pose
edge_shift    What an error of the blur, or of a saturated spot's border, would do to a pose
first_frame   Explains a frame by itself: its pose, and the texture of a wall that is not known yet
frame_fit     Fits the newest frame: other light has little weight, and the wall may have moved
frame_model   The model of one frame on the cells of a window
frame_state   The states of a frame, its model on the cells of a window, and what is known before
hidden        Pixels of a sharp spot that a tool hides, or on which its shadow lies
later_frame   Explains a frame together with earlier ones, which have shown a part of its wall
look          What is looked at: a frame, and what the robot says of it
mix           The mixture of a camera's channels in which the wall is most even
picture       The pixels of a frame: their light, and which of them show the wall
ranger        Distances and poses, for a calibration and a microscope file
reference     What an image of the wall without the spot says of the wall
registration  Where the wall's map lies in a frame in which the wall has moved
robot         How the tool has moved from the first frame to another one, as the robot says it
saturation    The light of a saturated spot with a sharp edge: how much of each cell it covers
solution      What a fit of some frames found
solver        Poses of some frames by Gauss-Newton, with the wall's texture eliminated
starts        Poses from which the fit of a first frame starts
texture       The wall's texture as a Gaussian process
tracker       Follows the pose from frame to frame
verdict       Whether a pose explains its frame, and what is stated of it
wall_motion   Where the wall's picture is in an image: shifted and turned since its map was begun
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
