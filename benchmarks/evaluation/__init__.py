"""What several studies compute: trials, tracked spots, model errors.

model_error    How far each model of the spot is from the truth, on exact contours and on measured
               spots
model_figures  Labels and colours of the models, and their errors against eccentricity
paper          What Zhou et al. 2020 report: Tables I and II; whether fits reproduce Table I
photographs    Photographs of kept linear frames, taken and measured again without rendering or
               files
statistics     Summaries of errors; Shapley values: the part of each cause in a sum
tracking       Spots of a rendered trial, measured in the ways that the report compares
trials         The trials of the main job: the paper's six, and a grid over eccentricity
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
