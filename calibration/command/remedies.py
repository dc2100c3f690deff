"""The criteria that a fit must meet, and what to try if it does not meet one."""

from __future__ import annotations

from enum import Enum, auto

from calibration.pixels import Criterion


class Fault(Enum):
    """The criterion that a fit does not meet."""

    STEPS = auto()
    FIRST_ROUND = auto()
    TABLES = auto()
    BOUND = auto()
    UNDETERMINED = auto()
    LARGE_RESIDUALS = auto()
    STRUCTURE = auto()
    MISFIT = auto()
    OVERSTATED_NOISE = auto()
    STATED_MISFIT = auto()

    @property
    def harmless(self) -> bool:
        """Whether the values are right within their errors."""
        return self in (Fault.OVERSTATED_NOISE, Fault.STATED_MISFIT)


OF_CRITERION = {
    Criterion.STEPS: Fault.STEPS,
    Criterion.FIRST_ROUND: Fault.FIRST_ROUND,
    Criterion.TABLES: Fault.TABLES,
}
"""The faults of a fit to pixels that does not converge."""

_PRIOR = "a prior (--prior NAME=MEAN,SIGMA)"
_FEWER = "fewer parameters (--free)"
_EVEN = "an even wall with nothing in front of it"
_SPREAD = "spread in --free, if the wall spreads light"
_CONE = "--model cone, which fits the exact geometry"
_LENS = "--model lens, if the spot's edge is soft"
_PLACES = "withdrawals at other places, one within 1 mm of the axis and one beyond 3 mm"
_ROBOT = (
    "to check that --eye-from-robot is right to a degree, that the eye did not turn, and that "
    "--cone belongs to this fibre; or leave out the withdrawal farthest from the axis"
)

_REMEDIES: dict[Fault, dict[str, str]] = {
    Fault.STEPS: {
        "": f"--robust, which leaves out outliers, or {_CONE}",
        "cone": f"{_FEWER}, or {_PRIOR} for those that are free",
        "eye": _PLACES,
        "image": f"{_FEWER}, or {_PRIOR} for those that are free",
        "lens": f"a lens to start from that is nearer to yours (--lens FILE), or {_FEWER}",
    },
    Fault.FIRST_ROUND: {
        "lens": "a lens to start from whose core, aperture and rim are yours (--lens FILE); or a "
        f"recording of {_EVEN}"
    },
    Fault.TABLES: {
        "lens": f"{_FEWER}, or a recording without the distances at which the spot is sharpest: "
        "there the lens's light is hardest to compute"
    },
    Fault.BOUND: {
        "": f"{_CONE}, or recordings at other distances from the wall",
        "cone": f"{_PRIOR} for the parameter at its bound, or a longer withdrawal",
        "eye": _PLACES,
        "image": f"{_PRIOR} for the parameter at its bound, or a longer withdrawal",
        "lens": f"{_PRIOR} for the parameter at its bound, or fit without it (--free)",
    },
    Fault.UNDETERMINED: {
        "": f"{_CONE}, and recordings at other places and distances",
        "cone": f"{_PRIOR} for one of them, or fit without it (--free)",
        "eye": _PLACES,
        "image": f"{_PRIOR} for one of them, or fit without it (--free)",
        "lens": f"{_PRIOR} for one of them, or fit without it (--free)",
    },
    Fault.LARGE_RESIDUALS: {
        "": f"--robust, which leaves out outliers, or {_CONE}",
        "cone": f"{_LENS}, or the microscope's scale and the eye's radius, which may be wrong, in "
        "--free",
        "eye": _ROBOT,
    },
    Fault.STRUCTURE: {
        "": f"{_CONE}, or --robust, which leaves out outliers",
        "cone": f"{_LENS}, or a recording of {_EVEN}",
        "eye": _ROBOT,
    },
    Fault.MISFIT: {
        "image": f"{_LENS}, {_SPREAD}, or a recording of {_EVEN}",
        "lens": f"{_SPREAD}, or a recording of {_EVEN}. A cap off centre, a tilted end and a "
        "Gaussian launch cannot be fitted",
    },
}
"""By fault and by model; the models of the paper have the name ""."""

_PAPERS = ("plane", "sphere")


def remedy(fault: Fault, *, model: str) -> str:
    """What to try, with options that the model has; empty if nothing is needed."""
    return _REMEDIES.get(fault, {}).get("" if model in _PAPERS else model, "")
