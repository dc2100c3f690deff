from .range import Range as Range
from .range import RangeFlag as RangeFlag
from .range import TipPose as TipPose
from .ranger import Ranger as Ranger
