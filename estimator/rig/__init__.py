"""The node of the rig, for ROS 1 and ROS 2, and a topic of images as a source."""
