"""The ROS 1 node.

node  ROS 1 node for the rig: microscope images in, the spot, its axes and its distance out
rig   Measures the images of the rig: parameters, poses and images in, outputs out
"""
