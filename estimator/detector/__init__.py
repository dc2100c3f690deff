"""From a frame to a spot: the paper's literal algorithm and sub-pixel mode.

band         A band of profiles along a contour: the mean profile, each ray's shift against it
broad        One refinement of a spot with a broad flank: a bell, or a plateau that falls off
             slowly
censored     The edge of a saturated spot, from the part of its flank that is not at full scale
coarse       Bright regions of a subsampled window, and the ellipses that they may be parts of
edges        The half-maximum contour of a bright region, from its profiles unwrapped about an
             ellipse
ellipse      Ellipses as images of the unit circle, and their fit to radial edge offsets
levels       Peak, background and edge width of a spot, from its profiles
literal      Literal mode: the paper's Algorithms 1 and 2 (Zhou et al. 2020), step by step
motion_blur  The ellipse in the middle of the exposure, of a spot that moved during it
reflex       Whether a bell is a spot, or a wet wall's reflex with the spot upon it
regions      Sub-pixel mode at work: bright regions of a window, the channel to take, the spot
             they hold
settings     Sub-pixel mode: the half-maximum contour of the linearised signal
shape        Shape of a spot's profile: a plateau, a bell, or what lies between
sharp        One refinement of a spot with a sharp edge
texture      The wall's texture told from its colours
tracking     From frame to frame: where to look, and what may be believed
unwrap       Profiles along the rays of an ellipse: sampling, and statistics round the ring of
             rays
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
