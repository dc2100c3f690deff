"""Stacks on disk.

again        A stack photographed anew from its noise-free frames, without rendering
check        What only a computation tells of a scene: whether it can be rendered
command      The commands `eyespot render` and `eyespot scene check`
photography  How the frames of a stack are photographed: exposures chosen, images and labels
             written
preview      One small frame of a scene, to look at before it is rendered
stack        From a scene to a labelled stack on disk
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
