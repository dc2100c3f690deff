"""From a spot to a distance, by one of the models.

cone_pose   Tip and axis of the sharp cone that leaves a spot's ellipse on the eyeball: the model
            `exact`
lens_range  Distance behind a glue lens: size, shape and brightness of the spot against the lens's
            light
range       What a spot becomes: a distance, its standard deviation, and what to know about it
ranger      From a spot to the distance between tip and wall, with its standard deviation
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
