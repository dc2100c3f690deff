"""Compares measured spots with the labels of a set: `eyespot score`.

command       The command `eyespot score`
entries       Entries of a leaderboard: a spots file or folder, and how it was made
images        The images of a set with their labels, and the conditions that group them
judging       Outcome and errors of each image, and their summary by condition
leaderboard   The leaderboard as a page
plain_spots   Plain spots files: the few columns that others can write without eyespot
sample        The small labelled set that comes with eyespot
scoring       The whole run: reads or measures spots, scores them, prints and writes tables
spots_of_set  Spots of a set: read from files, or measured by our estimator
standings     Ranks of the estimators on the same images, with intervals over stacks
views         Tables of a score on the terminal, and its figure
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
