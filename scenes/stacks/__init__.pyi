from .image import LiveCamera as LiveCamera
from .image import render_image as render_image
from .preview import write_preview as write_preview
from .stack import check_scene as check_scene
from .stack import least_bytes as least_bytes
from .stack import render_stack as render_stack
