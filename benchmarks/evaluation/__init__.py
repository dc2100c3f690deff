"""What several studies compute: trials, tracked spots, model errors.

calibrations  Calibrations that no file holds: what a study found, and what a scene truly is
lines         The paper's line d_r = delta k e1' + b through many trials at once
model_error   How far each model of the spot is from the truth, on exact contours and on measured
              spots
paper         What Zhou et al. 2020 report, as printed: Tables I and II
photographs   Photographs of kept linear frames, taken and measured again without rendering or
              files
tracking      Spots of a rendered trial, measured in the ways that the report compares
trials        The trials of the main job: the paper's six, and a grid over eccentricity
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
