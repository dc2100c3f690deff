"""The error while the tip moves.

command  The command `eyespot study dynamic`
figures  Pictures of the dynamic study
measure  From stacks to rows of dynamic_error.csv: calibrate at rest, read frames, split the
         errors
parts    What a moving tip adds to the error of a distance, part by part
report   The report of the dynamic study: sentences and tables, all from this run's numbers
run      `eyespot study dynamic`: the error of a distance while the tip moves, and what makes it
trials   The scenes of the dynamic study: moving tips at several speeds, and their twins held
         still
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
