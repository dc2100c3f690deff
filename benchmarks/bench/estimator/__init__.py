"""Accuracy and speed of the estimator, on frames with known ellipses.

accuracy     Compares errors, false spots and times with their limits
edge_bound   The least error with which a spot's size can be known on a wall of unknown texture
frame_kinds  The kinds of drawn frames, with the limits of the errors on them
lookalikes   Bright things that are no spots: lamps' reflexes, text, polygons and rings
methods      The compared methods: both modes of the estimator, and other software
own_frames   Frames drawn in NumPy alone, by other formulas than those of `scenes`
renders      Frames rendered by Mitsuba, with their labels
speed        Time per frame of both modes on the same frames
spotless     Frames without a spot: false spots, and how soon a lost spot is found again
stated_errors  Whether the errors lie within the stated standard deviations
tuning       Effect of each constant of the detector
"""
