from .beam import NODES as NODES
from .beam import Sweep as Sweep
from .frame_model import RobotPose as RobotPose
from .tracker import PixelRanger as PixelRanger
