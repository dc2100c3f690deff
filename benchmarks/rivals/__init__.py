"""Rivals: other ways to measure a spot, each an entry whose spots `eyespot score` ranks.

DIR of `eyespot rivals run SET --out DIR`:

    DIR/ENTRY/SPLIT/STACK.csv  the spots of a stack; of several exposures: STACK.EXPOSURE.csv
        ENTRY/entry.json       name, command, versions, constants, processor time per frame
"""
