"""The ROS 1 node.

messages  What the rig's node makes of messages: parameters, poses and images in, outputs out
node      ROS 1 node for the rig: microscope images in, the spot, its axes and its distance out
"""
