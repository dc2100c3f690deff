"""The studies: each a folder, each one command.

dynamic/       The error while the tip moves
eccentricity/  Model error against the place of the spot
medium/        Calibrated in air, used in vitreous
pose/          Tip and axis from one spot and from three
static/        Tables I and II over many runs, and what adds to their error
table_one/     Which lenses give Table I, and why its trials differ
validate/      The main job: the paper's static experiment on rendered images
"""
