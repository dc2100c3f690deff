"""Formats that a set is exported to: one module each, with one function `write`.

hdf5        one file, a group a stack
ome_tiff    one file a recording: a stack and one of its exposures
coco        images, and annotations a split
webdataset  tar shards a split
bags        one ROS 1 or ROS 2 bag a recording, with the rig's topics
"""
