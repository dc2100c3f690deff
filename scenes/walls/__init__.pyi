from .fundus_image import fundus as fundus
from .image_file import wall_image as wall_image
