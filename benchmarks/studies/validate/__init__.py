"""The main job: the paper's static experiment on rendered images.

analysis     Questions of yes or no that the report answers, as functions of the findings
command      The command `eyespot validate`
conclusions  What was found, in sentences whose numbers and verdicts are computed from the
             findings
figures      The report's figures but for the strip of frames, drawn from the rows of `tables`
page         The report as one HTML page: shapes rows into the tables that the template prints
report       Writes what a run found: report.html for people, summary.json, CSV and figures for
             the rest
run          The main job: the paper's static experiment on rendered images, and its model against
             the truth
strip        Frames of a withdrawal side by side, with the measured and the true ellipse drawn in
tables       The rows behind the report: one class a CSV file, its fields the columns, with units
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
