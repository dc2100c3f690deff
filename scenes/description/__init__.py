"""The scene file: its keys, their validation, and how it is read and written."""
