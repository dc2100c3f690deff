"""Spots of light in microscope frames: measured, tracked, written down.

::

    spot.py        what a measurement returns
    literal.py     the paper's algorithm, the reference
    subpixel.py    settings of the half-maximum contour, the default
    track.py       from frame to frame
    sources.py     opens what frames come from: images.py, videos.py, bags.py, a stack
    source.py        what all of them are
    ros_images.py    images of ROS messages
    poses.py       poses of the robot, by time
    reading.py     from a frame to a spot and its distance, for recordings and the rig alike
    options.py       what a person may choose of it
    offline.py     a source, read to its end
    overlay.py     what was measured, drawn over the frames
    track_command.py  the command `eyespot track`
    track_summary.py    what it says in the end
    rig_node.py    the node on the rig, under ROS 1
    rig.py           what it makes of messages
    spots.py       the spots file
    stack.py       the stack folder
    stack_writer.py  writes one, goes on where a stopped run was

    ranger.py      from a spot to a distance, by one of the models
    range.py         what it returns
    models.py        closed forms
    cone_pose.py     tip and axis of a sharp cone, by exact geometry
    lens_range.py    size, shape and brightness against the light of a glue lens
    shape.py           plateau or bell, read from the frame
    calibration_file.py  what a fit found
    model_parameters.py    names, units and ranges of parameters
    microscope_file.py   what is known of the microscope
    opencv_file.py         ... as OpenCV and ROS write it

    regions.py     sub-pixel mode at work: from a window to a spot
    coarse.py        bright regions of a subsampled window
    edges.py         the contour of one region: capture, levels, refinement
    levels.py          peak, background, edge width
    sharp.py           refinement at a sharp edge
    censored.py        ... of a plateau at full scale
    broad.py           refinement on a broad flank
    reflex.py        whether a bell is a spot, or a reflex that bears one
    motion_blur.py   the ellipse in the middle of the exposure, of a spot that moved
    band.py            profiles in a band along the contour
    unwrap.py        profiles along the rays of an ellipse
    ellipse.py       ellipses and their fit to edge offsets
    frames.py        accepted frames, response, reference frame
    camera.py        lens distortion
"""

from .calibration_file import Calibration as Calibration
from .calibration_file import CalibrationError as CalibrationError
from .calibration_file import read_calibration as read_calibration
from .calibration_file import write_calibration as write_calibration
from .camera import Camera as Camera
from .frames import Response as Response
from .literal import LiteralSettings as LiteralSettings
from .microscope_file import MicroscopeFile as MicroscopeFile
from .microscope_file import MicroscopeFileError as MicroscopeFileError
from .microscope_file import read_microscope as read_microscope
from .offline import Ended as Ended
from .offline import Tracking as Tracking
from .offline import track_source as track_source
from .poses import Pose as Pose
from .poses import PoseTrack as PoseTrack
from .poses import read_poses as read_poses
from .range import Range as Range
from .range import RangeFlag as RangeFlag
from .range import TipPose as TipPose
from .ranger import Ranger as Ranger
from .reading import Reader as Reader
from .reading import Reading as Reading
from .source import Frame as Frame
from .source import Source as Source
from .sources import open_source as open_source
from .spot import NoSpot as NoSpot
from .spot import Reason as Reason
from .spot import Spot as Spot
from .spots import SpotRecord as SpotRecord
from .spots import read_spots as read_spots
from .spots import write_spots as write_spots
from .stack import FrameLabels as FrameLabels
from .stack import Stack as Stack
from .stack import StackError as StackError
from .stack import read_stack as read_stack
from .stack_writer import StackWriter as StackWriter
from .subpixel import SubpixelSettings as SubpixelSettings
from .track import TrackState as TrackState
from .track import measure as measure
from .track import track as track
