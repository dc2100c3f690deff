"""Where what was computed once is kept for the next run."""

import os
import tempfile


def cache_folder() -> str:
    """The user's folder for caches: $XDG_CACHE_HOME, ~/.cache, or one for this user in /tmp.

    A user id in a container may have neither an entry in /etc/passwd nor $HOME; Python then leaves
    `~` as it is, and a folder of this name would appear wherever a command runs.
    """
    home = os.path.expanduser("~")
    usual = os.path.join(home, ".cache") if os.path.isabs(home) else None
    other = os.path.join(tempfile.gettempdir(), f"eyespot-cache-{os.getuid()}")
    return os.environ.get("XDG_CACHE_HOME") or usual or other
