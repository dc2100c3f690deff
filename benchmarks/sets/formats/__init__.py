"""Sets in other formats: `eyespot export`.

bags        ROS bags: SPLIT/STACK/EXPOSURE.bag (ROS 1) or SPLIT/STACK/EXPOSURE/ (ROS 2), labels
            beside it
coco        COCO: the frames as SPLIT/STACK/000000.png, annotations/SPLIT.json for each split
command     The command `eyespot export`
export      A set, or a stack by itself, written in another format
hdf5        HDF5: one file, a group SPLIT/STACK for each stack
ome_tiff    OME-TIFF: SPLIT/STACK/EXPOSURE.ome.tif, one file a recording, labels beside it
webdataset  WebDataset: tar shards SPLIT-000000.tar; a sample is an image, its mask and its labels
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
