"""Renders what is missing, then finishes the set: `eyespot dataset`.

card      The data card and the label tables of a set, from what its stacks hold
cluster   Dask workers for whole stacks: a local cluster, one core a worker, or a scheduler that
          runs
command   The commands `eyespot dataset make` and `eyespot dataset verify`
estimate  Frames, size and time of a set before it is made, from a few of its frames rendered now
generate  Makes a set: renders the stacks that are missing on Dask workers, then finishes it
manifest  Whether a set is whole: its manifest, written last, and what a folder lacks against it
pictures  Figures of a data card: how the labels are spread, and what the images look like
worker    What a worker does: one stack. Apart, so that workers import little else
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
