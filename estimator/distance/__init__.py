"""From a spot to a distance, by one of the models.

area         Distance from the area of the spot's ellipse for a known axis: model `area`
budget       What a distance is worth: its uncertainty by cause, in the terms of the GUM
budgets      Makes the budgets of distances: how far each cause moves a distance, and the model's
             error
cone_pose    Tip and axis of the sharp cone whose spot on the wall has a given ellipse: the
             model `exact`
lens_range   Distance behind a glue lens, from the size, shape and brightness of the spot
range        The distance of a spot, its standard deviation, and a flag if it is doubtful
ranger       From a spot to the distance between tip and wall, with its standard deviation
slopes       Derivatives of a cone's distance by all that it is computed from
tilted_cone  The spot of a tilted cone and its distance, in NumPy
view         The microscope and the eye as a calibration describes them
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
