from . import bags as bags
from .bags import IMAGE_TOPIC as IMAGE_TOPIC
from .bags import POSE_TOPIC as POSE_TOPIC
from .bags import write_bag as write_bag
from .opening import open_source as open_source
from .ros_images import frame_of_message as frame_of_message
from .source import Frame as Frame
from .source import Source as Source
