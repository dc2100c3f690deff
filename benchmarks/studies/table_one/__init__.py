"""Which lenses give Table I, and why its trials differ.

causes     The effect of each cause on delta k, b and -b/delta k of a lens's line
command    The command `eyespot study table-one`
figures    The figure of the report
findings   The results as data: lenses, their lines, and what changes a line
isophotes  Size of a lens's spot above a fixed threshold, in closed form
moments    Distances behind Table I, computed from its printed numbers
rendered   Lenses of the scan on rendered stacks, tracked in both modes
report     The report
run        The computation: scan, render, compare
scan       The threshold and range at which each lens is closest to Table I
"""
