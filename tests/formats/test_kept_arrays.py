"""Arrays kept in the cache are those that would be computed, whatever happens to their file."""

import io
import re
from functools import partial
from typing import Any

import numpy as np
import pytest

from eyespot import optics
from eyespot.formats.kept_arrays import kept_arrays
from eyespot.optics.wall_light.lens_flux import TABLE_CODE


def saved(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def test_what_was_computed_once_is_read_and_a_damaged_file_is_written_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    computed = []

    def compute() -> dict[str, np.ndarray]:
        computed.append(1)
        return {"values": np.arange(1000.0)}

    for runs, damage in [
        (1, lambda whole: whole),
        (1, lambda whole: whole[: len(whole) // 2]),
        (2, lambda whole: whole[:500] + bytes([whole[500] ^ 1]) + whole[501:]),
        (3, lambda whole: b""),
        (4, lambda whole: saved(other=np.arange(1000.0))),
        (5, lambda whole: saved(values=np.full(1000, np.nan))),
        (6, lambda whole: saved(values=np.arange(8.0)).replace(b"(8,), ", b"(9999999999,), ")),
        (7, lambda whole: whole),
    ]:
        found = kept_arrays("lens", ["values"], compute, inputs=1.49, code=())["values"]
        np.testing.assert_array_equal(found, np.arange(1000.0))
        assert len(computed) == runs
        (file,) = (tmp_path / "eyespot" / "lens").iterdir()
        file.write_bytes(damage(file.read_bytes()))


def test_other_inputs_and_other_code_are_computed_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    code = tmp_path / "code.py"
    for number, (index, text) in enumerate([(1.49, "x = 1"), (1.5, "x = 1"), (1.5, "x = 2")]):
        code.write_text(text)
        for _ in range(2):
            found = kept_arrays(
                "lens", ["n"], partial(dict, n=np.array(number)), inputs=index, code=[code]
            )
            assert found["n"] == number


@pytest.mark.parametrize("code", [optics.LIGHT_CODE, TABLE_CODE])
def test_a_lens_is_computed_anew_if_any_code_that_it_depends_on_changes(code):
    text = "".join(file.read_text() for file in code)
    imported = re.findall(r"^from eyespot\.optics\.([\w.]+) import", text, re.MULTILINE)
    used = {name.rpartition(".")[2] for name in imported}
    assert used <= {file.stem for file in code}


def test_a_cache_that_cannot_be_written_costs_no_result(tmp_path, monkeypatch):
    (tmp_path / "eyespot").write_text("a file where the folder would be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = kept_arrays("lens", ["values"], lambda: {"values": np.ones(3)}, inputs=0, code=())
    np.testing.assert_array_equal(kept["values"], np.ones(3))
