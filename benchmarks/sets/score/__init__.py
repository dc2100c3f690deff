"""How good spots are: `eyespot score`.

command       The command `eyespot score`
conditions    What images are scored apart by: the spot's place, how it was taken, what hides it
figure        A score as a figure: error and misses by condition, and how honest σ is
groups        How good estimators' spots of a labelled set are: all images together, and by
              condition
measures      How good an estimator is on a group of images: counts, errors, and how honest its σ
              are
outcomes      What an estimator made of each image of a set, beside the truth
scoring       Reads or measures spots of a set, scores them, prints tables and writes them
spots_of_set  Spots of a whole set: read from files, or measured by our own estimator
table         A score as tables on the terminal
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
