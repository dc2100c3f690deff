"""Distance from the spot, from the instrument's shadow, and from a stereo pair.

command   The command `eyespot study rivals`
expected  What each sensor can reach: stated noise, and one wrong assumption
figures   The figures of the report
findings  The results as data: noise, wrong assumptions, and readings of rendered images
marks     Marks in a picture: the tip, its shadow, and the height of the wall in a stereo pair
pictures  Rendered pictures: the instrument and its shadow, by three microscopes
rendered  The rendered part: all three sensors read distances from pictures of the same places
report    The report
run       The computation: expected errors, rendered pictures, readings
sensors   From marks in images to the distance of the tip from the wall
setup     The instrument, the light guide, the wall, and the microscopes
visible   Which sensors can see their marks: the window, the iris, the instrument in front
"""
