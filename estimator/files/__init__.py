"""The files that people exchange: formats, readers and writers.

calibration       Calibration file: JSON with a model's fitted parameters, their covariance and
                  their origin
camera_files      Camera calibrations as OpenCV, ROS and Kalibr write them, in YAML, JSON or XML
camera_sheet      The key `camera` of a microscope file: the camera's data sheet after EMVA 1288
csv_files         Reads CSV files that anyone may have written, row by row
decoded           An image as a file contains it, once it is decoded
image_files       Decodes image files that anyone may have written, with a limit of pixels
inside            Names of files that come from a file: they must stay within its folder
json_files        Reads JSON that anyone may have written
kept              Arrays that take long to compute, kept in the user's cache folder
manifest          Manifest of a folder: size and SHA-256 of every file in it, and what differs
                  from that
microscope        Microscope files: the stack's microscope.json, or a camera calibration of OpenCV,
                  ROS or Kalibr
model_parameters  Parameters of the models, with their units and ranges
pose_files        Reads the robot's poses from a CSV file or a ROS bag
poses             Poses of the robot: where the instrument's tip was, and in which direction it
                  pointed
ros_bags          ROS 1 and ROS 2 bags, opened without ROS: their topics and messages
shown_names       Names of files, and other text from files, as they are: without the markup of
                  what shows them
spots             The spots file: CSV or Parquet, one line per frame with the spot and its distance
spots_stream      Writes a spots file record by record, so that nothing measured is lost however a
                  run ends
stack             Stack folder: frames, masks, one line of labels per frame, the scene as run,
                  checksums
stack_writer      Writes a stack folder frame by frame, so that a stopped run can continue
stated            Stated uncertainties: TOML file of what a lab knows of its eye, robot and clocks
tiff_files        TIFF files in the dialects of cameras and microscopes: which pages are frames,
                  and their images
viewing           The keys of a microscope file that describe a viewing path and the retina
whole_files       Files that are written whole or not at all, and damaged files that are reported
                  in one error
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
