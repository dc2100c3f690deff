"""The studies: a file is one question, what is computed, its figures, its page and its command.

design        Which drop of glue, and how little light
dynamic       The error while the tip moves
eccentricity  Model error against the position of the spot
error_causes  For `eccentricity`: a model's error split by cause
eye           Distances through cornea, crystalline lens and the surgeon's viewing lens
eye_paths     For `eye`: its geometry, the drawn eyes, and the recipes that are compared
loop          The distance that a robot keeps by frames rendered in the loop
medium        The error of a calibration in air when it is used in vitreous
pose          Tip and axis from one spot and from three
sensor_views  For `sensors`: what spot, shadow and stereo pair show, and how they are read
sensors       The spot, the shadow and stereo as sensors of one distance
static        Spread of Tables I and II over many runs, and the causes of their error
table_one     Which lenses give Table I, and why its trials differ
validate      The main job: the paper's static experiment on rendered images
"""
