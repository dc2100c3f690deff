"""Renders a set: `eyespot dataset`.

card       Writes the data card and the label tables of a complete set
cluster    Dask workers: a local cluster with one core per worker, or a running scheduler
command    The commands `eyespot dataset make`, `verify` and `push`
croissant  Writes croissant.json: the set described for search engines and loaders
estimate   Estimates number of images, size and time from a few rendered frames
generate   Renders the missing stacks on Dask workers, then completes the set
manifest   Writes the manifest of a set, and verifies a set against it
pictures   Figures of the data card: histograms of the labels and sample images
push       Uploads a set to a repository of the Hugging Face Hub
worker     Renders one stack; a separate file, so that workers import little else
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
