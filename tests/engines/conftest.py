import pytest

from gctd3.deploy.contract import read_contract


@pytest.fixture
def contract(exported):
    """Return the contract of the policy that ships with the library."""
    return read_contract(exported.with_suffix(".json"))


@pytest.fixture(autouse=True)
def _programs(shared_folder, monkeypatch):
    """Keep what is compiled in the session's folder, once for all tests."""
    (shared_folder / "programs").mkdir(mode=0o700, exist_ok=True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared_folder / "programs"))
