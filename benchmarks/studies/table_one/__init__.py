"""Which lenses give Table I, and why its trials differ.

command   The command `eyespot study table-one`
moments   Distances behind Table I, computed from its printed numbers
rendered  Lenses of the scan on rendered stacks, tracked in both modes
run       The study: the best lenses, why trials differ, figure, page
scan      The threshold and range at which each lens is closest to Table I, in closed form
"""
