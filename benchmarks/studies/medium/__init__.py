"""The error of a calibration in air when it is used in vitreous.

command   The command `eyespot study medium`
figures   The figures of the report
findings  The results as data: curves of light sources, errors of distances
light     A lens's half-maximum radius in a medium, in closed form
rendered  The rendered part: calibrated on a plane in air, used in an eyeball with another medium
report    The report
run       The computation: curves, rendered frames, errors
"""
