"""Which lenses give Table I, and why its trials differ.

causes     What makes trials of one lens differ: each cause's effect on delta k, b and
           -b/delta k
command    The command `eyespot study table-one`
figures    The figure of the study of Table I: which lenses fit, and spots of some of them against
           distance
findings   What the study of Table I finds: lenses, their lines, and what changes a line
isophotes  Lenses, and the size of their spots over a fixed threshold, in closed form
moments    What the printed figures of Table I imply for the distances behind them, by arithmetic
rendered   Lenses of the scan on rendered stacks: three withdrawals from a plane, tracked in
           both modes
report     The report of the study of Table I
run        `eyespot study table-one`: which lenses give the paper's Table I, and what sets
           trials apart
scan       The scan: the threshold and range at which each lens comes nearest to Table I
"""
