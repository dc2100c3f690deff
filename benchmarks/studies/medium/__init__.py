"""Calibrated in air, used in vitreous.

command   The command `eyespot study medium`
figures   Figures of the study of media
findings  What the study of media finds: curves of lights, errors of distances
light     What a medium makes of a lens's half-maximum radius, in closed form from the lens's
          light
rendered  The rendered part: calibrated on a plane in air, used in an eyeball full of another
          medium
report    The report of the study of media
run       `eyespot study medium`: calibrated in air, used in vitreous
"""
