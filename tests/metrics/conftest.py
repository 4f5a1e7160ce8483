"""The textures on which the scores are tested."""

import pytest
from cases import MODELS, Case, case


@pytest.fixture(params=MODELS, scope="session")
def own(request: pytest.FixtureRequest) -> Case:
    """Return each case in turn. Tests of one case run together, because few references are kept."""
    return case(request.param)
