"""Spread of Tables I and II over many runs, and the causes of their error.

command  The command `eyespot study static`
run      The study: runs, fits, figures, page
trials   The rendered withdrawals, photographed and measured under each set of causes
"""
