"""The main job: the paper's static experiment on rendered images.

analysis  The range that reproduces Table I best; distances at which a lens's radius is ambiguous
claims    The claims, with their values and bounds
command   The command `eyespot validate`
figures   The figures of the report, except the strips of frames
findings  The results as data: tracked trials, fits, model errors, rows of the CSV files
fits      The fits of Tables I and II and the model errors
report    The report: the errors of the models first, then the paper's tables
run       The computation: render, track, fit
strip     Frames of a withdrawal side by side, with the measured and the true ellipse
tables    The rows of the CSV files
"""
