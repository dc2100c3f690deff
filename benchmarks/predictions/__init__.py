"""What an experiment will measure, written down before it; and which of that came true.

command     The commands `eyespot preregister` and `eyespot adjudicate`
judging     Compares a recording with a plan: hits, misses, and what explains the misses
observing   What a recording says about the quantities of a plan
plan        The plan's file: predictions with intervals, fingerprinted
predicting  Makes a plan from a scene, stated uncertainties, and a rehearsal
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
