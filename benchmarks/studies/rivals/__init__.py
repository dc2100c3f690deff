"""Distance from the spot, from the instrument's shadow, and from a stereo pair.

command   The command `eyespot study rivals`
expected  What each sensor can reach: stated noise, and one wrong assumption
marks     Marks in a picture: the tip, its shadow, and the height of the wall in a stereo pair
pictures  Rendered pictures: the instrument and its shadow, by three microscopes
rendered  The rendered part: all three sensors read distances from pictures of the same places
run       The study: expected errors, readings of rendered pictures, figures, page
sensors   Which sensors see their marks, and the distances that follow from marks
setup     The instrument, the light guide, the wall, and the microscopes
"""
