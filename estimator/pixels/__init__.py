"""Tip and axis of the beam from all pixels of the spot, on a wall that is learnt meanwhile."""
