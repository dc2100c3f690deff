"""Sources of frames: stacks, images, videos, cameras, ROS bags."""
