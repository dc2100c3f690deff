from .beam import NODES as NODES
from .beam import Sweep as Sweep
from .ranger import PixelRanger as PixelRanger
from .robot import RobotPose as RobotPose
