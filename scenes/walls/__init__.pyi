from .fundus_image import fundus as fundus
from .picture import PICTURE_MM as PICTURE_MM
from .picture import PICTURE_PX as PICTURE_PX
from .picture import wall_colour as wall_colour
from .picture import wall_picture as wall_picture
from .random_wall import write_random_wall as write_random_wall
from .spread import PRESETS_MM as PRESETS_MM
from .spread import wall_spread as wall_spread
