"""Pictures on the wall."""
