"""Code that all studies share, independent of any of them.

command     The options of the studies' commands
figures     Style, small multiples and files of figures
report      Claims, sections with tables and pictures, CSV files; one HTML page of them
study       One run of a study: its request, scene, stacks and folder
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
