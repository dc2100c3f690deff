from .planning import PlannedStack as PlannedStack
from .planning import plan as plan
from .spec import SetSpec as SetSpec
from .spec import load_spec as load_spec
