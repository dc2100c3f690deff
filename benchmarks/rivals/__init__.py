"""Rivals: other ways to measure a spot, each an entry whose spots `eyespot score` ranks.

command   The commands `eyespot rivals run`, `tune` and `train`
entries   All entries: OpenCV, scikit-image, pupil-detectors, the network, eyespot's own modes
learned/  A small network from frame to ellipse and distance
pupil     The detector of pupil-detectors, in its own environment
running   Runs entries over the stacks of a set; their free constants, and how they are chosen

DIR of `eyespot rivals run SET --out DIR`:

    DIR/ENTRY/SPLIT/STACK.csv  the spots of a stack; of several exposures: STACK.EXPOSURE.csv
        ENTRY/entry.json       name, command, versions, constants, processor time per frame
"""
