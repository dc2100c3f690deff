"""Uploads a set to a repository of the Hugging Face Hub."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from benchmarks.sets.make.manifest import verify_set
from benchmarks.sets.read.labelled_set import read_set
from optics import InputError


def push_set(
    folder: Path, repository: str, *, private: bool = False, endpoint: str | None = None
) -> str:
    """Upload a complete set as one commit; the repository is created if it does not exist.

    Files that are there already and have not changed are not sent again.

    Args:
        repository: OWNER/NAME of a dataset repository.
        private: whether a new repository is private.
        endpoint: address of the Hub (default: that of huggingface_hub).

    Returns:
        Address of the commit.

    Raises:
        SetError: the set is incomplete or changed.
        InputError: huggingface_hub is not installed, or the Hub refuses or cannot be reached.
    """
    hub = _library()
    verify_set(folder)
    name = read_set(folder).name
    api = hub.HfApi(endpoint=endpoint, library_name="eyespot")
    # HTTPError is that of the HTTP library that huggingface_hub uses; a missing token an OSError.
    problems = (hub.errors.HTTPError, hub.errors.HFValidationError, OSError)
    try:
        api.create_repo(repository, repo_type="dataset", private=private, exist_ok=True)
        # Not upload_large_folder, which keeps its state in a folder within the set.
        commit = api.upload_folder(
            repo_id=repository,
            repo_type="dataset",
            folder_path=folder,
            commit_message=f"{name} as eyespot rendered it",
        )
    except (*problems, RuntimeError) as error:
        # A failed upload of one file is a RuntimeError that follows from one of the others.
        if isinstance(error, RuntimeError) and not isinstance(error.__cause__, problems):
            raise
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"the Hub did not take {folder} as {repository}: {said[:300]}. Check the name, the "
            "network, and the access token with write permission (`hf auth login`, or HF_TOKEN)."
        ) from error
    return str(commit.commit_url)


def _library() -> Any:
    try:
        importlib.import_module("huggingface_hub.errors")
    except ModuleNotFoundError as error:
        raise InputError(
            "`dataset push` needs the package huggingface_hub: pip install 'eyespot[hub]'."
        ) from error
    return importlib.import_module("huggingface_hub")
