"""The node of the rig, for ROS 1 and ROS 2, and a topic of images as a source.

generation    Which ROS is there: 1 or 2
messages      An output as the messages of the node's topics
node          The node: runs under the ROS that is there
recent_poses  The poses that the robot has sent last
rig           Measures the images of the rig: parameters, poses and images in, outputs out
ros1          The node under ROS 1
ros2          The node under ROS 2
silence       Notices when images stop, says why, and notices when they are back
topic         A topic of images as a live source, under the ROS that is there
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
