import pytest

from toolkit.sites.files import load_site


@pytest.fixture(scope="session")
def site():
    return load_site("tjunction")
