"""Accuracy and speed of the estimator, on frames with known ellipses.

frame_kinds  Kinds of drawn frames
lookalikes   Bright things that are no spots: lamps' reflexes, text, polygons and rings
own_frames   Frames drawn in NumPy alone, by other formulas than those of `scenes`
speed        Time per frame of both modes on the same frames
spotless     Frames without a spot: false spots, and how soon a lost spot is found again
stated_errors  Whether the errors lie within the stated standard deviations
tuning       Effect of each constant of the detector
"""
