from .bag_images import IMAGE_TOPIC as IMAGE_TOPIC
from .bag_images import read_frames as read_frames
from .bag_writer import write_bag as write_bag
from .bag_writer import write_messages as write_messages
from .opening import open_source as open_source
from .ros_images import frame_of_message as frame_of_message
from .source import Frame as Frame
from .source import Source as Source
