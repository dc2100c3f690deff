"""The main job: the paper's static experiment on rendered images.

analysis  Where a fit reproduces Table I best, and where a lens's radius is ambiguous
claims    The claims of the main job
command   The command `eyespot validate`
figures   The report's figures except the strips of frames, drawn from the rows of spots.csv
findings  What the main job finds: tracked trials, fits, model errors, and the rows of its CSV files
fits      The fits of Tables I and II, and the model errors, from the tracked trials
report    The report of the main job: the models' errors first, then the paper's tables
run       The main job: the paper's static experiment on rendered images, and its model against
          the truth
strip     Frames of a withdrawal side by side, with the measured and the true ellipse drawn in
tables    The rows of the CSV files, from the findings
"""
