"""Spread of Tables I and II over many runs, and the causes of their error.

bench     Rendered withdrawals, photographed and measured under each set of causes
causes    The error that each cause adds to the paper's line, alone and together
command   The command `eyespot study static`
figures   The figures of the report
findings  The results as data: Tables I and II of many runs, and the parts of their error
report    The report
run       The computation: render once, photograph and measure many times, fit
tables    Tables I and II of every run, and their spread
"""
