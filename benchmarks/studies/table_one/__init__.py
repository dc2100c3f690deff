"""Which lenses give Table I, and why its trials differ.

causes       What makes trials of one lens differ: each cause's own mark on delta k, b and
             -b/delta k
command      The command `eyespot study table-one`
conclusions  What the study of Table I found, in sentences whose numbers are this run's
figure       The figure on Table I: which lenses fit, and spots of some of them against distance
moments      What the printed figures of Table I say of the distances behind them, by arithmetic
             alone
rendered     Lenses of the scan on rendered stacks: three withdrawals from a plane, tracked in
             both modes
report       The report on Table I: tables and the figure, all from this run's numbers
run          `eyespot study table-one`: which lenses give the paper's Table I, and what sets
             trials apart
scan         Lenses against a fixed threshold, in closed form: the isophote's radius against
             distance
"""
