"""Plans without their report."""

from functools import partial
from unittest.mock import patch

import pytest


@pytest.fixture(scope="session")
def without_report():
    """Makes a context in which a plan has no report, whose pictures take half of its time."""
    return partial(patch, "placement_env.report.planning.plan_writing.write_report")
