from . import build as build
from . import rivals as rivals
from .differentiable import PhotonImage as PhotonImage
from .glass import glass_images as glass_images
from .images import Images as Images
from .photons import photon_image as photon_image
from .render import LinearFrame as LinearFrame
from .render import Renderer as Renderer
