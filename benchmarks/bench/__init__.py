"""Benchmarks of speed and accuracy in the form of asv: classes with parameters, no tables.

`python -m benchmarks.bench NAME` runs one of them; `make bench` runs those that take minutes. What
`eyespot score` and the studies measure is not measured here again.

__main__  The command line: runs classes and prints their table
detector  Time of a frame in sub-pixel and literal mode
fits      Accuracy and time of fits to spots, to pixels and through glass
load      Long runs: `eyespot track`, a `Reader` at a camera's pace, the books of a large set
pixels    The mode pixels on drawn stacks: errors, stated errors, adverse conditions, memory
viewing   Time of lines of sight, exact spots and frames through a contact lens into an eye
"""
