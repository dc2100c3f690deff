"""Tables I and II over many runs, and what adds to their error.

bench    Rendered withdrawals, photographed and measured under each set of causes
causes   What each cause adds to the error of the paper's line: alone, and all together
command  The command `eyespot study static`
figures  Pictures of the static study
report   The report of the static study: sentences, tables and pictures, all from this run's
         numbers
run      `eyespot study static`: the paper's Tables I and II over many runs, and what adds to
         their error
tables   Tables I and II of every run, and their spread beside the paper's figures
"""
