"""`eyespot dataset push` against a stand-in for the Hub on this machine."""

import huggingface_hub.constants
import pytest

from benchmarks.sets.make import push
from benchmarks.sets.read import SetError, verify_set
from benchmarks.sets.score.spots import sample_folder
from formats.inputs import InputError
from tests.command_line import printed
from tests.hub_stand_in import stand_in

TOKEN = "stand-in"

# What huggingface_hub calls in its own HTTP library is deprecated there.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")


@pytest.fixture
def hub(monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_DISABLE_PROGRESS_BARS", True)
    with stand_in(TOKEN) as server:
        yield server


def test_the_set_arrives_whole(hub, tmp_path):
    said = printed("dataset", "push", sample_folder(), "a-lab/sample", "--endpoint", hub.address)
    assert f"Wrote {hub.address}/datasets/a-lab/sample/commit/" in said
    for name, content in hub.files["a-lab/sample"].items():
        path = tmp_path / "copy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    assert verify_set(tmp_path / "copy") == verify_set(sample_folder())


@pytest.mark.parametrize(("token", "name"), [("another", "a-lab/sample"), (TOKEN, "a lab/sample")])
def test_a_refused_token_or_name_is_one_message_with_the_remedy(hub, monkeypatch, token, name):
    monkeypatch.setenv("HF_TOKEN", token)
    with pytest.raises(InputError, match=rf"did not take .* as {name}.*hf auth login"):
        push(sample_folder(), name, endpoint=hub.address)
    assert not hub.files


def test_a_hub_that_cannot_be_reached_is_one_message(monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    with stand_in(TOKEN) as server:
        address = server.address
    with pytest.raises(InputError, match="did not take"):
        push(sample_folder(), "a-lab/sample", endpoint=address)


def test_what_is_no_complete_set_is_not_sent(hub, tmp_path):
    with pytest.raises(SetError, match="not a labelled set"):
        push(tmp_path, "a-lab/sample", endpoint=hub.address)
    assert not hub.files
