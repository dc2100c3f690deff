"""Tables I and II over many runs, and what adds to their error.

bench     Rendered withdrawals, photographed and measured under each set of causes
causes    What each cause adds to the error of the paper's line: alone, and all together
command   The command `eyespot study static`
figures   Figures of the static study
findings  What the static study finds: Tables I and II of many runs, and the parts of their error
report    The report of the static study
run       `eyespot study static`: the paper's Tables I and II over many runs, and what adds to
          their error
tables    Tables I and II of every run, and their spread beside the paper's figures
"""
