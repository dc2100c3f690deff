from .camera import Camera as Camera
from .information import light_information as light_information
