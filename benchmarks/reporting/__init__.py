"""What all studies share; it knows none of them.

claims      Claims: what a run found, each a number beside what was expected of it
command     The options that the commands of all studies share
figures     Figures of one style: colours, small multiples, and the files that they are written to
page        The report as one HTML page
report      What a report is made of: claims, sections with tables and pictures, CSV files
run_folder  The folder of a run: taken by one request, resumed by the same one, never half written
study       One run of a study: its request, its scene, its stacks, its folder
tables      Tables: what a column shows, rows as a table of the report, rows as a CSV file
typeset     Numbers as text, alone and in sentences
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
