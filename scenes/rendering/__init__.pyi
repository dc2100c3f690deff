from . import build as build
from . import rivals as rivals
from .differentiable import PhotonImage as PhotonImage
from .images import Images as Images
from .photons import photon_image as photon_image
from .render import LinearFrame as LinearFrame
from .render import Renderer as Renderer
from .wall import wall_colour as wall_colour
