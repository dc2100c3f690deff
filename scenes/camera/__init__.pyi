from .camera import Camera as Camera
