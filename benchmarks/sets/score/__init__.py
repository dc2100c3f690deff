"""Compares measured spots with the labels of a set: `eyespot score`.

command       The command `eyespot score`
conditions    Conditions by which images are grouped: position, exposure, occlusion ...
entries       Entries of a leaderboard: a spots file or folder, and how it was made
figure        Figure of a score: errors and missed spots by condition, calibration of σ
groups        Scores of each estimator, for all images and by condition
leaderboard   The leaderboard as a page
measures      Counts, errors and calibration of σ for a group of images
outcomes      Outcome of each image: spot found, missed, misplaced ...
plain_spots   Plain spots files: the few columns that others can write without eyespot
sample        The small labelled set that comes with eyespot
scoring       The whole run: reads or measures spots, scores them, prints and writes tables
spots_of_set  Spots of a set: read from files, or measured by our estimator
standings     Ranks of the estimators on the same images, with intervals over stacks
table         Tables of a score on the terminal
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
