"""Sources of frames: stacks, images, videos, cameras, ROS bags.

bag_images  The images of ROS 1 and ROS 2 bags as a source, read without ROS
bag_writer  Writes ROS 1 and ROS 2 bags with the rig's topics, without ROS
genicam     GenICam cameras as live sources, through harvesters and their vendors' GenTL producers
images      Image files as sources: a folder of them, one of them, the pages of a TIFF
opening     Opens a source: a stack, images, a video, a camera or a bag
ros_images  Images of ROS messages as frames, and back; for bags and for a live node alike
source      A source of frames of any kind; `open_source` makes one
videos      Videos and cameras as sources, both through OpenCV
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
