"""A user id without an entry in /etc/passwd and without HOME, as containers have them."""

import pwd
import tempfile

import pytest

from eyespot.formats.cache_folder import cache_folder


@pytest.fixture
def nobody(monkeypatch):
    """No home: Python's expanduser leaves ~ as it is."""
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)

    def unknown(uid: int) -> None:
        raise KeyError(uid)

    monkeypatch.setattr(pwd, "getpwuid", unknown)


def test_without_a_home_the_cache_is_this_users_in_the_folder_for_temporary_files(nobody):
    assert cache_folder().startswith(f"{tempfile.gettempdir()}/eyespot-cache-")


def test_a_named_cache_goes_first(nobody, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == str(tmp_path)
