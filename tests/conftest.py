"""Tests of one file run in one process, and so do all that ask for the one small study, which takes longest: first."""

import pytest
from hypothesis import settings

# How long an example takes depends on what else the machine does.
settings.register_profile("halfseen", deadline=None)
settings.load_profile("halfseen")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: not _asks_for_study(item))
    for item in items:
        item.add_marker(pytest.mark.xdist_group("the small study" if _asks_for_study(item) else str(item.path)))


def _asks_for_study(item):
    return "study_folder" in getattr(item, "fixturenames", ())
