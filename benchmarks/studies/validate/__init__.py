"""The main job: the paper's static experiment on rendered images.

command  The command `eyespot validate`
figures  The figures of the report: of the spots, of the models' errors, and strips of frames
run      The main job: render, track, fit; its claims and its page
tables   The fits of Tables I and II, the model errors, and the tables of the CSV files
"""
