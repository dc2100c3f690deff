from .beam import NODES as NODES
from .beam import Pose as Pose
from .beam import Sweep as Sweep
from .beam import blurred as blurred
from .beam import blurred_with_growth as blurred_with_growth
from .frame_model import RobotPose as RobotPose
from .tracker import PixelRanger as PixelRanger
