from .command import fit as fit
