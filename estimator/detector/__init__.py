"""From a frame to a spot: the paper's literal algorithm and the sub-pixel mode.

A frame goes down this list in the sub-pixel mode, and the spot comes back:

tracking  From frame to frame: where the spot is looked for, which of the spots found is it, and
          where it may be if none was measured
verdict   Spot or not: every reason to reject what was fitted, and the spots that are fitted again,
          because they moved or lie on a reflection
contour   Bright regions that may be the spot, and the half-maximum contour of one: which light it
          is fitted to, and through which ellipse
edges     Fits an ellipse to the half-maximum contour in a patch of light, from its profiles along
          rays
band      A band of profiles along a contour: the mean profile, each ray's shift against it, and one
          refinement of a spot with a sharp edge
levels    Peak, background and edge width of a spot, from its profiles
coarse    The colour channel to measure in, and the bright regions of a subsampled window with the
          ellipses of which they may be parts
ellipse   Ellipses as images of the unit circle, their fit to radial edge offsets, and profiles
          along their rays

settings  Settings of the sub-pixel mode
tuning    Every constant of the sub-pixel mode, in one table
shape     Shape of a spot's profile: plateau, bell, or something in between
literal   Literal mode: the paper's Algorithms 1 and 2 (Zhou et al. 2020), step by step
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
