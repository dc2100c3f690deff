"""What all studies share: run folder, page, tables, figures.

command     The options that the commands of all studies share
run_folder  The folder of a run: taken once, resumed by the same request, filled with whole files
            only
study       What all studies share: what was asked for, the run's folder, and the report
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
