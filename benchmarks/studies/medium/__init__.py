"""The error of a calibration in air when it is used in vitreous.

command   The command `eyespot study medium`
light     Half-maximum radius of a light in a medium, in closed form
rendered  The rendered part: calibrated on a plane in air, used in an eyeball with another medium
run       The study: curves, rendered frames, errors, figures, page
"""
