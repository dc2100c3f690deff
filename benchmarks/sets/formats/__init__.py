"""Writes sets in other formats: `eyespot export`.

bags        ROS bags: SPLIT/STACK/EXPOSURE.bag (ROS 1) or SPLIT/STACK/EXPOSURE/ (ROS 2)
coco        COCO: images SPLIT/STACK/000000.png, and annotations/SPLIT.json for each split
command     The command `eyespot export`
export      Writes a set or a single stack in one of these formats
hdf5        HDF5: one file with a group SPLIT/STACK for each stack
ome_tiff    OME-TIFF: one file SPLIT/STACK/EXPOSURE.ome.tif for each recording
webdataset  WebDataset: tar shards SPLIT-000000.tar; a sample is an image with mask and labels
"""
