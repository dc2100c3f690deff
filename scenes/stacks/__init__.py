"""Labelled image stacks on disk.

bound                The Cramér-Rao bound of the ellipse in an image
command              The commands `eyespot render` and `eyespot scene check`
ellipse_information  Fisher information of an image about the ellipse of its light
image                One image of a scene, without a stack on disk
photography          Chooses the exposure times of a stack, and writes its images and labels
preview              One small frame of a scene, for a quick look
stack                Checks a scene, and renders it into a labelled stack
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
