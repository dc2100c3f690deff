"""Code that all studies share, independent of any of them.

claims      A claim: a measured value, its bounds, and a sentence
command     The options of the studies' commands
figures     Style, small multiples and files of figures
page        A report as one HTML page, with its CSV files and figures
report      The parts of a report: claims, sections with tables and pictures, CSV files
run_folder  The folder of a run, which the same request resumes; files appear only when complete
study       One run of a study: its request, scene, stacks and folder
tables      Tables of the report and CSV files
typeset     Numbers as text, alone and in sentences
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
