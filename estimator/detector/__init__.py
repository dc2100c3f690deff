"""From a frame to a spot: the paper's literal algorithm and the sub-pixel mode.

A frame goes down this list in the sub-pixel mode, and the spot comes back:

tracking     From frame to frame: where the spot is looked for, and which of the spots found is it
verdict      Spot or not: every reason to reject what was fitted, in one place
motion_blur  The ellipse in the middle of the exposure, of a spot that moved during it
reflection   Distinguishes a broad spot from a specular reflection of a wet wall with the spot on it
hollow       Dark places inside an ellipse that nothing which reaches in from outside can explain
contour      The half-maximum contour of a region: which light it is fitted to, and through which
             ellipse
texture      The wall's texture, estimated from its colours
outlines     Where the spot may be in a frame in which none was measured
regions      Bright regions of a frame that may be the spot: anywhere in a window, or at the last
             contour
channel      The colour channel in which a region of a frame is measured
edges        Fits an ellipse to the half-maximum contour in a patch of light, from its profiles
             along rays
sharp        One refinement of a spot with a sharp edge
broad        One refinement of a spot with a broad flank: a bell, or a plateau that falls off slowly
censored     The edge of a saturated spot, from the part of its flank that is below full scale
band         A band of profiles along a contour: the mean profile, and each ray's shift against it
levels       Peak, background and edge width of a spot, from its profiles
coarse       Bright regions of a subsampled window, and the ellipses of which they may be parts
unwrap       Profiles along the rays of an ellipse: sampling, and statistics round the ring of rays
ellipse      Ellipses as images of the unit circle, and their fit to radial edge offsets

settings     Settings of the sub-pixel mode
tuning       Every constant of the sub-pixel mode, in one table
shape        Shape of a spot's profile: plateau, bell, or something in between
literal      Literal mode: the paper's Algorithms 1 and 2 (Zhou et al. 2020), step by step
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
