"""Questions from plain options."""

import math

import pytest

from placement_env.cases import Cases
from placement_env.report.planning.question import Question, Stock
from placement_env.setting import Setting
from toolkit.runtime.run import Run

STOCK = ("candidates", "catalogue", "keep_out", "capacity_kbit")
CASES = ("iou", "failing", "failures", "levels", "levels_by", "errors", "errors_by")
SETTING = ("classes", "scheme", "codec", "detector", "keep", "link_share")
RUN = ("seed", "frames", "cache", "workers", "ray", "progress")


def build(site, **options):
    def take(names):
        return {name: options.pop(name) for name in names if name in options}

    most = options.pop("money", math.inf)
    stock, cases = Stock(**take(STOCK)), Cases(**take(CASES))
    setting = Setting(site, candidates=stock, cases=cases, most_price=most, **take(SETTING))
    return Question(setting, Run(**take(RUN)), **options)


@pytest.fixture(scope="session")
def ask():
    return build
