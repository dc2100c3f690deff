"""Placeholder until the table is written."""
import equinox as eqx


class IrradianceTable(eqx.Module):
    pass
