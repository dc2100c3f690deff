"""The studies: one folder and one command each.

dynamic/       The error while the tip moves
eccentricity/  Model error against the position of the spot
eye/           Distances through cornea, crystalline lens and the surgeon's viewing lens
medium/        The error of a calibration in air when it is used in vitreous
pose/          Tip and axis from one spot and from three
rivals/       The spot, the shadow and stereo as sensors of one distance
static/        Spread of Tables I and II over many runs, and the causes of their error
table_one/     Which lenses give Table I, and why its trials differ
validate/      The main job: the paper's static experiment on rendered images
"""
