"""Rivals: other ways to measure a spot, each an entry whose spots `eyespot score` ranks.

command        The commands `eyespot rivals run`, `tune` and `train`
entries        All entries by name; eyespot's own modes and the network as entries
entry          What an entry is: a frame goes in, an ellipse or a miss comes out
learned/       A small network from frame to ellipse and distance
opencv         OpenCV: threshold, contour, ellipse fit
pupil          The detector of pupil-detectors, in its own environment
pupil_entry    pupil-detectors as an entry
running        Runs entries over the stacks of a set; their free constants
scikit_image   scikit-image's EllipseModel with RANSAC
tuning         Chooses the constants on the split train

DIR of `eyespot rivals run SET --out DIR`:

    DIR/ENTRY/SPLIT/STACK.csv  the spots of a stack; of several exposures: STACK.EXPOSURE.csv
        ENTRY/entry.json       name, command, versions, constants, processor time per frame
"""
