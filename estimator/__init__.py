"""Spots of light in microscope frames: measured, tracked, written down.

::

    spot.py        what a measurement returns
    literal.py     the paper's algorithm, the reference
    subpixel.py    settings of the half-maximum contour, the default
    track.py       from frame to frame
    spots.py       the spots file
    stack.py       the stack folder

    regions.py     sub-pixel mode at work: from a window to a spot
    coarse.py        bright regions of a subsampled window
    edges.py         the contour of one region: capture, levels, refinement
    levels.py          peak, background, edge width
    sharp.py           refinement at a sharp edge
    censored.py        ... of a plateau at full scale
    broad.py           refinement on a broad flank
    band.py            profiles in a band along the contour
    unwrap.py        profiles along the rays of an ellipse
    ellipse.py       ellipses and their fit to edge offsets
    frames.py        accepted frames, response, reference frame
    camera.py        lens distortion
"""

from .camera import Camera as Camera
from .frames import Response as Response
from .literal import LiteralSettings as LiteralSettings
from .spot import NoSpot as NoSpot
from .spot import Reason as Reason
from .spot import Spot as Spot
from .spots import SpotRecord as SpotRecord
from .spots import read_spots as read_spots
from .spots import write_spots as write_spots
from .stack import FrameLabels as FrameLabels
from .stack import Stack as Stack
from .stack import StackError as StackError
from .stack import StackWriter as StackWriter
from .stack import read_stack as read_stack
from .subpixel import SubpixelSettings as SubpixelSettings
from .track import TrackState as TrackState
from .track import measure as measure
from .track import track as track
